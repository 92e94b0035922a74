"""Prediction folders: pictures that a method drew elsewhere, in a strict layout, checked and then scored.

    manifest.json                           what the pictures answer, and who drew them
    SUBJECT/POSE/CAMERA/LIGHTING.exr        one picture a query (.png where the manifest says sRGB)
    times.json                              optional: what the authors say drawing took
    README…, LICENSE…                       optional: for people
    asked/                                  optional: what `write_template` put there; never read

manifest.py   the two JSON files
picture.py    one EXR file
folder.py     the whole folder against what a protocol asks
template.py   what a protocol asks, for software that is not handbench

`handbench.methods.predictions` is a folder as a method of the bench.
"""

from .folder import Asked, PredictionFolder, read_folder
from .manifest import DeclaredTimes, PredictionManifest
from .problems import Problems, Unfit
from .template import write_template

__all__ = [
    "Asked",
    "DeclaredTimes",
    "PredictionFolder",
    "PredictionManifest",
    "Problems",
    "Unfit",
    "read_folder",
    "write_template",
]
