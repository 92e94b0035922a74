"""A protocol is a TOML file; the entry points to the value read from it."""

from pathlib import Path

from handbench.protocols import load

PROTOCOL = load(Path(__file__).with_name("example.toml"))
