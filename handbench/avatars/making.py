"""Portraits made: of a subject of a run, by its kept training; and from a capture of one's own."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ..bench import given
from ..bench.isolation import isolated
from ..bench.opening import select
from ..bench.plan import check_preset, make_method
from ..bench.progress import Steps
from ..bench.protocol import digest
from ..bench.reader import CaptureReader
from ..bench.reopening import capture_of, method_as, protocol_of
from ..bench.store import Store
from ..data.capture import Capture
from ..errors import InputError, Unsupported, unknown_name
from ..hand import hand_model, hand_of
from ..hand.known import SHIPPED
from ..method import Avatar, Method, MethodInfo, Prior
from ..recording import Recording
from ..registry import METHODS
from ..results.reading import Run, read_run
from ..scene import Array, Query
from ..tuning import tune
from .portrait import Portrait, licence_of
from .repertoire import Body, Repertoire


def from_run(
    folder: Path,
    method: str,
    subject: str | None,
    told: Steps,
    seed: int | None = None,
    data: Path | None = None,
    protocol: str | None = None,
) -> Portrait:
    """A subject of a run as a method knows it: the run's kept training, personalised by the run's enrolment.

    subject     None: the first that is scored
    seed        None: the run's first
    data        where captures are kept
    protocol    the file of the run's protocol, where it is no registered one

    Raises `InputError` for names that the run does not know, a training that it has not kept, a protocol or a capture
    that is another one than the run's; `Unsupported` if the subject cannot be personalised.
    """
    run = read_run(folder)
    made, preset = _method_of(run, method)
    found = protocol_of(run, protocol)
    seed = run.plan.seeds_for(method)[0] if seed is None else seed
    if made.info.truth or not made.info.timed:
        raise InputError(f"{made.info.title} looks recorded pictures up and draws none; name another method")
    prior, key = _prior_of(run, made, method, seed)
    capture = capture_of(run, found, data, told)
    selected = select(found, capture)
    enrolled = sorted({frame.subject for frame in selected.enrol})
    who = found.subjects[0] if subject is None else subject
    if who not in enrolled:
        raise unknown_name(f"subject of {folder}:", who, enrolled)
    if refusal := given.refusal(selected, made.info, who):
        raise Unsupported(refusal)
    enrolment = given.enrolment(selected, made.info, who, CaptureReader(capture))
    avatar = _personalised(prior, enrolment, seed, told, f"{made.info.title}, {who}: personalise")
    gives = found.enrol.gives
    frames = [frame for frame in capture.frames() if frame.subject == who]
    queries = [given.asked(selected, made.info, frame) for frame in frames]
    shape = next((frame.shape for frame in frames if frame.shape is not None and "shape" in gives), None)
    repertoire = Repertoire.of(queries, _body(capture, made.info, shape, queries), avatar.found)
    source = f"{who} of {capture.name} ({capture.digest[:16]}), protocol {found.label}, seed {seed}"
    about = (preset, dict(made.config), prior, avatar, repertoire, source, licence_of(capture.hand))
    return Portrait(made.info.title, made.info, *about, digest([key, found.digest, who, seed]))


def drawing_methods(folder: Path) -> list[str]:
    """The names of a run's methods that can be shown: not those that look recorded pictures up."""
    methods = read_run(folder).plan.methods
    if not (found := [method.name for method in methods if method.timed and not method.truth]):
        raise InputError(f"{folder} has no method that draws; name another run")
    return found


def from_capture(
    capture: Capture,
    enrolment: Recording,
    name: str,
    told: Steps,
    preset: str = "quick",
    seed: int = 0,
    prior_run: Path | None = None,
    licence: str = "",
) -> Portrait:
    """A portrait from pictures of one's own: `enrolment` is what the capture gives of one subject.

    A method that learns from other people first takes what it learned in `prior_run`, a run of it.
    Raises `InputError` for an unknown method or preset, or one that needs a run; `Unsupported`, with the reason, for
    pictures that lack what the method needs or in which it finds no hand.
    """
    check_preset((METHODS.entry(name),), None if preset == "quick" else preset)
    key = ""  # of the training
    if prior_run is None:
        method = make_method(METHODS.entry(name), preset)
        if method.info.trains_on:
            needs = given.worded(method.info.trains_on)
            raise InputError(
                f"{method.info.title} learns from other people first ({needs}); name a run that trained it with "
                f"--prior, such as that of 'handbench run phone --methods {name}'"
            )
        with isolated():
            prior = method.train(enrolment.where(lambda frame: False), seed)
    else:
        run = read_run(prior_run)
        method, preset = _method_of(run, name)
        prior, key = _prior_of(run, method, name, run.plan.seeds_for(name)[0])
    lacking = method.info.needs - (capture.offers & enrolment.gives) - given.kinds_of(enrolment.frames)
    if lacking:
        raise Unsupported(f"{method.info.title} needs {given.worded(lacking)}, which {capture.name} does not have")
    subject = enrolment.subjects[0]
    avatar = _personalised(prior, enrolment, seed, told, f"{method.info.title}, {subject}: personalise")
    shape = next((frame.shape for frame in enrolment.frames if frame.shape is not None), None)
    queries = [frame.query for frame in enrolment.frames]
    repertoire = Repertoire.of(queries, _body(capture, method.info, shape, queries), avatar.found)
    source = f"{len(enrolment.frames)} pictures of {subject} in {capture.name}"
    about = (preset, dict(method.config), prior, avatar, repertoire, source, licence or licence_of(capture.hand))
    decided = digest([name, method.config, capture.digest, [frame.key for frame in enrolment.frames], seed, key])
    return Portrait(method.info.title, method.info, *about, decided)


def _personalised(prior: Prior, enrolment: Recording, seed: int, told: Steps, label: str) -> Avatar:
    tune()
    with isolated():
        return prior.personalise(enrolment, seed, told(label))


def _method_of(run: Run, name: str) -> tuple[Method, str]:
    """A method of a run as it was set there, and its preset. Raises `InputError` for one that is not in it, or that
    has no such settings here."""
    known = [method.name for method in run.plan.methods]
    if name not in known:
        raise unknown_name(f"method of {run.folder}:", name, known)
    record = run.plan.method(name)
    try:
        return method_as(METHODS.entry(name), record.preset, record.config), record.preset
    except InputError as error:
        raise InputError(f"{run.folder} cannot be shown here: {error}; run it again") from error


def _prior_of(run: Run, method: Method, name: str, seed: int) -> tuple[Prior, str]:
    """What a method learned in a run, and its key. Raises `InputError` if it is not kept, or is of another version."""
    kept = next((cell.prior for cell in run.cells if cell.method.name == name and cell.seed == seed and cell.prior), "")
    store = Store(run.folder)
    if not kept or store.prior(kept) is None:
        raise InputError(f"{run.folder} keeps no training of {name} with seed {seed}; run it again into this folder")
    with isolated():
        return method.load(store.sound_state(kept)), kept


def _body(capture: Capture, info: MethodInfo, shape: Array | None, queries: Iterable[Query]) -> Body | None:
    """What poses the subject anew: the capture's hand model, or for methods that bring their own mesh the shipped one.

    None where a method is given meshes and the capture does not tell how to make others.
    """
    if "mesh" not in info.needs:
        return Body(SHIPPED, np.asarray(hand_model(SHIPPED).neutral() if shape is None else shape, np.float64), None)
    mesh = next((query.mesh for query in queries if query.mesh is not None), None)
    if capture.hand is None or shape is None or mesh is None:
        return None
    try:
        hand, level = hand_of(mesh.topology)
    except Unsupported:
        return None  # the recorded meshes are of another surface
    return Body(hand.name, shape, level) if hand.name == capture.hand else None
