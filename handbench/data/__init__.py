"""Captures: the open ones and readers of recorded ones; `ENTRIES` is the table the harness reads."""

from ..registry import Entry

_OPEN = "handbench.data.openstage:open_capture"
_READERS = "handbench.data.readers"

ENTRIES: tuple[Entry, ...] = (
    Entry("openstage", _OPEN, "the open light stage: path traced from a CC0 hand"),
    Entry("openscans", _OPEN, "many people scanned in a studio: poses, cameras, meshes", (("capture", "openscans"),)),
    Entry("openwild", _OPEN, "moving hands before one camera in unknown light, and relit", (("capture", "openwild"),)),
    Entry("openphone", _OPEN, "hands scanned by phone in unknown light, and relit", (("capture", "openphone"),)),
    Entry(
        "goliath", f"{_READERS}.goliath:open_capture", "Goliath's hands on a light stage; bring them: HANDBENCH_GOLIATH"
    ),
    Entry("harp", f"{_READERS}.harp:open_capture", "HARP's hands before one camera; bring them: HANDBENCH_HARP"),
    Entry("palm", f"{_READERS}.palm:open_capture", "PALM's people before seven cameras; bring them: HANDBENCH_PALM"),
    Entry("interhand", f"{_READERS}.interhand:open_capture", "InterHand2.6M; bring it: HANDBENCH_INTERHAND"),
    Entry("reinterhand", f"{_READERS}.reinterhand:open_capture", "Re:InterHand; bring it: HANDBENCH_REINTERHAND"),
    Entry("uhm", f"{_READERS}.uhm:open_capture", "phone scans as UHM reads them; bring them: HANDBENCH_UHM"),
)
