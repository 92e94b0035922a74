"""What a file from outside is, by its first bytes, and how large a picture may be before memory is taken for it."""

from __future__ import annotations

from pathlib import Path

from ..errors import InputError

MAX_PIXELS = 1 << 26
"""Pixels of the largest picture that is read unless another limit is said: 8,192 x 8,192."""

_STARTS = {
    b"\x76\x2f\x31\x01": "EXR",
    b"\x89PNG\r\n\x1a\n": "PNG",
    b"\xff\xd8\xff": "JPEG",
    b"\x93NUMPY": "numpy file",
    b"PK\x03\x04": "zip archive (.npz)",
    b"PK\x05\x06": "zip archive (.npz)",
    b"#?": "Radiance picture",
    b"\xabKTX 1": "KTX texture",
    b"II*\x00": "TIFF",
    b"MM\x00*": "TIFF",
    b"GIF8": "GIF",
    b"BM": "BMP",
    b"RIFF": "WebP",
    b"%PDF": "PDF",
}
_NAMED = {
    ".exr": ("EXR",),
    ".png": ("PNG", "JPEG", "AVIF"),  # all hold display codes, and the decoder looks at the content
    ".jpg": ("PNG", "JPEG", "AVIF"),
    ".jpeg": ("PNG", "JPEG", "AVIF"),
    ".avif": ("PNG", "JPEG", "AVIF"),
    ".npy": ("numpy file",),
    ".npz": ("zip archive (.npz)",),
    ".hdr": ("Radiance picture",),
    ".rgbe": ("Radiance picture",),
    ".ktx": ("KTX texture",),
}


def check_kind(path: Path, what: str) -> None:
    """Raises `InputError` if there is no regular file, or one of another kind than its name says.

    `what` is what messages call it: "picture". Bytes of no known kind pass: a decoder says more about them.
    """
    if not path.is_file():
        raise InputError(f"{what} {path} {'is no regular file' if path.exists() else 'does not exist'}; check its path")
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise InputError(f"{what} {path} cannot be read ({error.strerror}); check its permissions") from error
    if not head:
        raise InputError(f"{what} {path} is damaged: the file is empty; write it anew")
    suffix = path.suffix.lower()
    found = next((kind for start, kind in _STARTS.items() if head.startswith(start)), None)
    if head[4:11] == b"ftypavi":
        found = "AVIF"
    if found is not None and found not in _NAMED.get(suffix, (found,)):
        article = "an" if found[0] in "EA" else "a"
        raise InputError(f"{what} {path} is {article} {found} named {suffix}; give it the name of what it is")


def check_size(path: Path, what: str, width: int, height: int, max_pixels: int = MAX_PIXELS) -> None:
    """Raises `InputError` for a picture without pixels, or of more than `max_pixels`."""
    if width < 1 or height < 1:
        raise InputError(f"{what} {path} is {width}x{height} pixels: it is empty or damaged")
    if width * height > max_pixels:
        raise InputError(
            f"{what} {path} is {width}x{height}, more than {max_pixels} pixels; make it smaller, or raise the limit "
            "(--max-pixels)"
        )
