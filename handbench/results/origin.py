"""Where a result comes from: parts of the records of `record`."""

from __future__ import annotations

from dataclasses import dataclass

from .schema import told


@dataclass(frozen=True, slots=True)
class Git:
    """The checkout that code came from."""

    commit: str | None = told("the commit")
    dirty: bool = told("whether there were uncommitted changes")


@dataclass(frozen=True, slots=True)
class Plugin:
    """A package of plug-ins."""

    version: str | None = told("its installed version", default=None)
    git: Git | None = told("its checkout, null for an installed copy", default=None)


@dataclass(frozen=True, slots=True)
class Hardware:
    """The machine, for telling which times may be compared."""

    cpu: str = told("model of the processor")
    cores: int | None = told("processor cores that the process may use")
    threads: int | None = told("threads that it uses")
    memory_gb: float | None = told("memory in GiB", default=None)
    gpus: tuple[str, ...] = told("models of the GPUs that torch sees", default=())
    networks: str = told("the device that networks were offered, such as cpu or cuda", default="")


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a result comes from, captured when the run started."""

    version: str = told("of handbench")
    git: Git | None = told("handbench's checkout, null for an installed copy")
    command: str = told("the command line")
    python: str = told("version of Python", default="")
    packages: dict[str, str] = told("versions of the packages that handbench needs", default_factory=dict)
    plugins: dict[str, Plugin] = told("packages of plug-ins from elsewhere", default_factory=dict)
    os: str = told("the operating system", default="")
    device: Hardware | None = told("the machine", default=None)
    started: str = told("when the run started, in UTC, ISO 8601", default="")
