"""Letters that LaTeX's own fonts do not have.

pylatexenc knows a command for most signs, but many of its commands need packages or an encoding of fonts that a plain
article has not, and its words for Chinese are none. Here a letter passes if a plain article class has it, with
pdfLaTeX and with LuaLaTeX; any other becomes `\\hbletter`, which shows it where the font has it, and else its base
letter or its code: nothing vanishes, and nothing stops the compiler.
"""

from __future__ import annotations

import unicodedata
from functools import lru_cache
from typing import Any

# Latin letters with accents, Greek, and single signs of text and mathematics.
_BLOCKS = ((0xA0, 0x17F), (0x384, 0x3CE))
_SIGNS = "–—―‘’“”†‡•…‰€™←↑→↓↔⇐⇑⇒⇓⇔∀∂∃∇∈∉∋∏∑−∓∗√∝∞∧∨∩∪∫∼≈≠≡≤≥⊂⊃⊆⊇⊕⊗⊥⋅"
# Of the blocks, those whose command needs an encoding of fonts that a plain article has not.
_ABSENT = "«»ÐÞðþĄąĐđĘęĮįŉŊŋŲųΐΰ"
GUARD = r"""% A letter that the font lacks is shown as what stands for it.
\ifdefined\hbletter\else
  \DeclareRobustCommand{\hbletter}[2]{\ifdefined\directlua\iffontchar\font"#1 \char"#1 \else#2\fi\else#2\fi}
\fi"""


def is_plain(letter: str) -> bool:
    """Whether a plain article can show a letter that is not ASCII."""
    code = ord(letter)
    return letter in _SIGNS or (any(low <= code <= high for low, high in _BLOCKS) and letter not in _ABSENT)


def guarded(letter: str) -> str:
    """A letter as `\\hbletter`: its code, and what is shown where there is none of it."""
    base = unicodedata.normalize("NFKD", letter)[:1]
    shown = base if base.isascii() and base.isalnum() else f"U+{ord(letter):04X}"
    return f"\\hbletter{{{ord(letter):04X}}}{{{shown}}}"


@lru_cache(maxsize=1)
def encoder() -> Any:
    """pylatexenc's encoder for the letters that are plain."""
    from pylatexenc.latexencode import UnicodeToLatexEncoder

    return UnicodeToLatexEncoder(
        replacement_latex_protection="braces", unknown_char_policy=guarded, unknown_char_warning=False
    )
