"""What official evaluators compute, reproduced on purpose with their oddities, one module an evaluator.

A number of a paper was made by the code of that paper; two papers' "PSNR" may differ by 10 dB on one picture. These
metrics say what one prediction scores under each. None is a recommendation: `handbench.metrics` has our own.
`docs/compatibility.md` tells of every evaluator what it computes, where that was read, and what it does to a number.
"""

from collections.abc import Iterator

from handbench.registry import Entry


def _of(evaluator: str, module: str, **quantities: str) -> Iterator[Entry]:
    """The metrics of an evaluator: `psnr_hdr` is named evaluator-psnr-hdr and stands in the module as PSNR_HDR."""
    for quantity, title in quantities.items():
        name = f"{evaluator}-{quantity.replace('_', '-')}"
        target = f"{__name__}.{module}:{quantity.upper()}"
        yield Entry(name, target, f"{title} as the code of {evaluator.removesuffix('-official')} computes it")


ENTRIES: tuple[Entry, ...] = (
    *_of("palm-official", "palm", psnr="PSNR", ssim="SSIM", lpips="LPIPS (VGG)"),
    *_of("goliath", "goliath", psnr="PSNR", ssim="SSIM"),
    *_of("harp", "harp", lpips="LPIPS (Alex)", ms_ssim="MS-SSIM", l1="mean absolute difference", iou="silhouette IoU"),
    *_of("uhm", "uhm", psnr="PSNR", ssim="SSIM", lpips="LPIPS (Alex)", iou="mask IoU"),
    *_of("stanford-orb", "stanford_orb", psnr_hdr="PSNR-H", psnr_ldr="PSNR-L", ssim="SSIM", lpips="LPIPS (VGG)"),
    *_of("objects-with-lighting", "objects_with_lighting", psnr="PSNR", ssim="SSIM", lpips="LPIPS (Alex)"),
)
