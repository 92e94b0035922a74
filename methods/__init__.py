"""The relighting methods that come with handbench; `ENTRIES` is the table the harness reads."""

from handbench.registry import Entry

from .ablations import ABLATIONS

ENTRIES: tuple[Entry, ...] = (
    Entry(
        "oracle",
        "handbench.methods.oracle:create",
        "the path-traced truth fed back: perfect, or the run is wrong",
        presets=False,
    ),
    Entry("mean", "handbench.methods.mean:create", "mean texture under the mean light: the floor", presets=False),
    Entry(
        "phong",
        "handbench.methods.reflectance.phong:create",
        "mean texture, Phong reflectance, fitted on the training subjects",
    ),
    Entry(
        "physical",
        "handbench.methods.reflectance.physical:create",
        "mean texture, the parametric BRDF of URHand on the coarse mesh",
    ),
    Entry(
        "transfer",
        "handbench.methods.transfer:create",
        "per texel, least squares of a spherical-harmonic transfer over one person's training light",
    ),
    Entry(
        "relightablehands",
        "handbench.methods.relightablehands:create",
        "texture decoder of one identity on a mesh, one pass a light",
    ),
    Entry(
        "urhand", "handbench.methods.urhand:create", "URHand: physical branch, neural branch, linear lighting network"
    ),
    *(
        Entry(
            f"urhand-{name}",
            "handbench.methods.urhand:create",
            f"ablation of urhand: {a.summary}",
            (("ablation", name),),
        )
        for name, a in ABLATIONS.items()
    ),
    Entry(
        "urhand-phone",
        "handbench.methods.phone.method:create_urhand",
        "URHand personalised from a scan by phone in unknown light, its shadow divided out",
    ),
    Entry(
        "sh-phone",
        "handbench.methods.phone.method:create_harmonic",
        "the same scan, light and albedo solved together, the parametric BRDF of URHand",
    ),
    Entry(
        "mean-phone", "handbench.methods.phone.mean:create", "the mean of the scan's pictures: the floor", presets=False
    ),
    Entry(
        "harp",
        "handbench.methods.harp:create",
        "HARP: displaced hand, albedo and normal map in one point light, from pictures in unknown light",
    ),
    *(
        Entry(
            f"handy-{name}",
            f"handbench.methods.handy:create_{name}",
            f"Handy-style: a texture found in a generator's space on the given or fitted hand, albedo under {title}",
        )
        for name, title in (("phong", "Phong"), ("ggx", "GGX"))
    ),
    Entry(
        "uhm",
        "handbench.methods.uhm:create",
        "UHM-style adaptation: texture without shadows on a fitted hand, from pictures in unknown light",
    ),
    Entry(
        "palm-net",
        "handbench.methods.palm:create",
        "PALM-Net: an implicit surface and reflectance of many people, one picture by fixed networks",
    ),
    *(
        Entry(
            f"palm-net-{name}", "handbench.methods.palm:create", f"ablation of palm-net: {about}", (("ablation", name),)
        )
        for name, about in (
            ("no-normals", "a prior that learned without normals"),
            ("fixed-light", "the studio's light instead of a fitted one"),
        )
    ),
    *(
        Entry(
            f"{name}-tracked",
            "handbench.methods.geometry.method:create",
            f"{name} on meshes of the hand geometry autoencoder instead of the capture's",
            (("method", name),),
        )
        for name in ("physical", "urhand")
    ),
)
