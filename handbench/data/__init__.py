"""Captures: the open ones and readers of recorded ones; `ENTRIES` is the table the harness reads."""

from ..registry import Entry

_OPEN = "handbench.data.openstage:open_capture"

ENTRIES: tuple[Entry, ...] = (
    Entry("openstage", _OPEN, "the open light stage: path traced from a CC0 hand"),
    Entry("openscans", _OPEN, "many people scanned in a studio: poses, cameras, meshes", (("capture", "openscans"),)),
    Entry("openwild", _OPEN, "moving hands before one camera in unknown light, and relit", (("capture", "openwild"),)),
    Entry("openphone", _OPEN, "hands scanned by phone in unknown light, and relit", (("capture", "openphone"),)),
)
