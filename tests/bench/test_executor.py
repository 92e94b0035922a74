"""Any number of processes, here or on a cluster, compute a run as one would, and nothing twice."""

from __future__ import annotations

import errno
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from flat import flat_cells as cells
from hypothesis import given
from hypothesis import strategies as st

from handbench import claims
from handbench.bench import cluster
from handbench.bench.executor import Job
from handbench.bench.plan import Cell, by_prior
from handbench.bench.protocol import Protocol
from handbench.bench.run import run
from handbench.bench.store import Store
from handbench.claims import claim, holder
from handbench.cli import main
from handbench.errors import InputError
from handbench.results.schema import plain
from handbench.shards import Shard

FAKES = Path(__file__).parent / "fakes"
PATIENCE = 240.0  # seconds, after which a process hangs: a busy machine takes a minute to start three


def comparable(folder: Path) -> str:
    """Everything that a run tells but times, memory, machine and command."""
    left = ("times", "cost", "provenance", "device")
    told = {name: value for name, value in plain(Store(folder).run()).items() if name not in left}
    kept = [{name: value for name, value in cell.items() if name not in left} for cell in cells(folder)]
    return json.dumps([told, kept], sort_keys=True)


def leftovers(folder: Path) -> list[Path]:
    names = [path for path in folder.rglob("*") if path.name.endswith((".tmp", ".part"))]
    return [*names, *folder.glob("claims/*"), *folder.glob("checkpoints/*")]


def wait_for(seen: Callable[[], Any], seconds: float = PATIENCE) -> Any:
    end = time.monotonic() + seconds
    while not (found := seen()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)
    return found


# --- claims ---------------------------------------------------------------------------------------------------------


def test_a_claim_is_one_processes_and_goes_with_it(tmp_path):
    place = tmp_path / "claims" / "key"
    with claim(place) as mine:
        assert mine and f"process {os.getpid()}" in holder(place)
        with claim(place) as second:
            assert not second
        assert place.exists(), "who is refused removes nothing"
    assert not place.exists()
    with claim(place) as again:
        assert again


def test_a_killed_process_has_no_claim(tmp_path):
    script = (
        "import sys, time, pathlib\n"
        "from handbench.bench.store import Store\n"
        "with Store(pathlib.Path(sys.argv[1])).claim('key') as mine:\n"
        "    print(mine, flush=True)\n"
        "    time.sleep(60)\n"
    )
    store = Store(tmp_path)
    process = subprocess.Popen([sys.executable, "-c", script, tmp_path], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "True\n"
    with store.claim("key") as mine:
        assert not mine
    assert f"process {process.pid}" in store.holder("other", "key")
    process.send_signal(signal.SIGKILL)
    process.communicate()
    store.prepare()
    assert not list((tmp_path / "claims").iterdir()), "what it left is swept"
    with store.claim("key") as mine:
        assert mine


def test_the_lock_of_a_removed_file_is_no_claim(tmp_path, monkeypatch):
    """Between our opening and our locking its owner is through and removes it, and somebody else makes it anew."""
    place, real = tmp_path / "key", claims.fcntl.flock

    with ExitStack() as other:

        def late(descriptor: int, how: int) -> None:
            monkeypatch.setattr(claims.fcntl, "flock", real)
            place.unlink()
            assert other.enter_context(claim(place))
            real(descriptor, how)

        monkeypatch.setattr(claims.fcntl, "flock", late)
        with claim(place) as mine:
            assert not mine
        assert place.exists()


def test_without_locks_everybody_has_the_claim(tmp_path, monkeypatch):
    def none(descriptor: int, how: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(claims.fcntl, "flock", none)
    with claim(tmp_path / "key") as one, claim(tmp_path / "key") as other:
        assert one and other


def test_claims_under_contention_are_held_by_one_at_a_time(tmp_path):
    script = (
        "import os, sys, pathlib\n"
        "from handbench.claims import claim\n"
        "folder, count = pathlib.Path(sys.argv[1]), 0\n"
        "while count < 200:\n"
        "    with claim(folder / 'claims' / 'key') as mine:\n"
        "        if mine:\n"
        "            os.close(os.open(folder / 'inside', os.O_CREAT | os.O_EXCL))\n"
        "            os.unlink(folder / 'inside')\n"
        "            count += 1\n"
    )
    both = [subprocess.Popen([sys.executable, "-c", script, tmp_path], stderr=subprocess.PIPE) for _ in range(3)]
    for process in both:
        _, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, errors.decode()


# --- shards ---------------------------------------------------------------------------------------------------------


def plan_cells(methods: int, seeds: int, subjects: int) -> tuple[Cell, ...]:
    return tuple(
        Cell(f"{m}-{s}-{who}", f"{m}-{s}", f"method-{m}", "quick", f"s{who:02d}", s)
        for m in range(methods)
        for s in range(seeds)
        for who in range(subjects)
    )


@given(st.integers(1, 6), st.integers(1, 3), st.integers(1, 7), st.integers(1, 40))
def test_shards_are_the_plan_in_parts(methods, seeds, subjects, count):
    whole = plan_cells(methods, seeds, subjects)
    shards = [Shard(i, count).of(by_prior(whole)) for i in range(1, count + 1)]
    assert sorted(cell.key for shard in shards for cell in shard) == sorted(cell.key for cell in whole)
    trained = [len(by_prior(shard)) for shard in shards]
    if count <= methods * seeds:
        assert sum(trained) == methods * seeds, "no training in two shards"
        assert max(trained) - min(trained) <= 1
    else:
        assert max(trained) <= 1
        assert sum(map(bool, shards)) >= min(count, methods * seeds), "no shard idles while others have two trainings"


@pytest.mark.parametrize("text", ["", "1", "1/", "/2", "a/b", "1/2/3", "-1/2", "1.5/2", "²/3", "1" * 40 + "/2"])
def test_a_shard_that_cannot_be_read(text):
    with pytest.raises(InputError, match="cannot be read; give i/n"):
        Shard.parse(text)


@pytest.mark.parametrize("text", ["0/4", "5/4", "1/0"])
def test_a_shard_out_of_range(text, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "smoke", "--shard", text]) == 2
    assert (
        capsys.readouterr().err
        == f"handbench: shard {text} does not exist; give i/n with i from 1 to n, such as 1/4 … 4/4\n"
    )
    assert not list(tmp_path.iterdir())


def test_shards_make_the_run_that_one_process_makes(fakes, toy_protocol, tmp_path):
    protocol = toy_protocol(methods=["toy", "toy-nan", "toy-identity"])
    command = ["handbench", "run", "toy"]
    run(protocol, out=tmp_path / "whole", seeds=[0, 1], command=command)
    fakes.CALLS.clear()
    told: set[bytes] = set()
    outcomes = []
    for number in (2, 4, 1, 3):
        shard = Shard(number, 4)
        parts = (f"--shard={shard}",) if number % 2 else ("--shard", str(shard))
        outcomes.append(run(protocol, out=tmp_path / "parts", seeds=[0, 1], command=[*command, *parts], shard=shard))
        told.add((tmp_path / "parts" / "run.json").read_bytes())
    assert len(told) == 1, "every shard tells the whole plan, in the same words"
    assert Store(tmp_path / "parts").run().provenance.command == "handbench run toy"
    assert [outcome.computed for outcome in outcomes] == [4, 2, 4, 2]
    assert [len(outcome.missing) for outcome in outcomes] == [8, 6, 2, 0]
    assert outcomes[2].missing == ("toy-nan s01 seed 0", "toy-nan s02 seed 0")
    assert sum(fakes.CALLS[f"{name} train"] for name in ("toy", "toy-nan", "toy-identity")) == 6, "each once"
    assert comparable(tmp_path / "parts") == comparable(tmp_path / "whole")
    after = run(protocol, out=tmp_path / "parts", seeds=[0, 1], command=command)
    assert (after.computed, after.reused, after.missing) == (0, 12, ())


def test_a_shard_says_what_is_not_there_yet_and_the_last_one_writes_the_report(
    fakes, toy_table, tmp_path, monkeypatch, capsys
):
    import handbench.reports

    monkeypatch.setattr(handbench.reports, "write_reports", lambda folder, table: {"index.html": folder / "page.html"})
    monkeypatch.setattr(handbench.reports, "table", lambda folder: "the table")
    monkeypatch.setattr(handbench.reports, "render_terminal", lambda table: table)
    path = tmp_path / "toy.toml"
    path.write_text(toml(toy_table(methods=["toy", "toy-nan"])))
    command = ["run", str(path), "--out", str(tmp_path / "run")]
    assert main([*command, "--shard", "1/2"]) == 0
    out = capsys.readouterr().out
    assert "shard 1/2: 2 cells computed, 0 reused" in out
    assert "not there yet, of other shards: 2 cells, toy-nan s01 seed 0, toy-nan s02 seed 0" in out
    assert "the table" not in out and "page.html" not in out
    assert main([*command, "--shard", "2/2"]) == 0
    out = capsys.readouterr().out
    assert "shard 2/2: 2 cells computed, 0 reused" in out and "the table" in out and "page.html" in out


def toml(table: dict[str, Any]) -> str:
    def lines(values: dict[str, Any]) -> str:
        return "".join(f"{k} = {json.dumps(v)}\n" for k, v in values.items() if not nested(v))

    def nested(value: Any) -> bool:
        return isinstance(value, dict) or (isinstance(value, list) and any(isinstance(v, dict) for v in value))

    sections = [f"[{name}]\n{lines(value)}" for name, value in table.items() if isinstance(value, dict)]
    sections += [f"[[column]]\n{lines(column)}" for column in table["column"]]
    return "\n".join([lines(table), *sections])


# --- processes that share a folder ----------------------------------------------------------------------------------


@pytest.fixture
def toys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The toy capture as a plug-in of an installed package, here and in every process that is started; $TOYS."""
    folder = tmp_path / "toys"
    (folder / "trainings").mkdir(parents=True)
    package = folder / "site" / "toyplugins-1.0.dist-info"
    package.mkdir(parents=True)
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: toyplugins\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[handbench.captures]\ntoy = clusterfakes:CAPTURE\n")
    for place in (FAKES, folder / "site"):
        monkeypatch.syspath_prepend(str(place))
    places = (str(FAKES), str(folder / "site"), os.environ.get("PYTHONPATH", ""))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, places)))
    monkeypatch.setenv("TOYS", str(folder))
    yield folder
    for name in ("benchfakes", "clusterfakes", "toyruns"):
        sys.modules.pop(name, None)


def trainings(toys: Path) -> list[str]:
    return sorted(path.name for path in (toys / "trainings").iterdir())


def test_two_processes_share_the_work_and_a_training_is_done_once(toys, toy_table, tmp_path):
    from toyruns import ToyRun

    table = toy_table()
    both = [ToyRun(table, tmp_path / "run", "slow,toy") for _ in range(2)]
    wait_for(lambda: len(trainings(toys)) == 2)
    time.sleep(0.5)
    assert len(trainings(toys)) == 2, "one training each"
    (toys / "go").touch()
    outcomes = [each.told(PATIENCE) for each in both]
    assert sum(outcome[0] for outcome in outcomes) == 8, outcomes
    assert [sum(outcome[:2]) for outcome in outcomes] == [8, 8]
    assert len(trainings(toys)) == 2 and not leftovers(tmp_path / "run")


def test_shards_at_the_same_time_make_the_run_that_one_process_makes(toys, toy_table, tmp_path):
    from toyruns import ToyRun, toy_run

    (toys / "go").touch()
    table = toy_table()
    shards = [ToyRun(table, tmp_path / "parts", "slow,toy", f"{number}/3") for number in (1, 2, 3)]
    outcomes = [each.told(PATIENCE) for each in shards]
    assert [outcome[:2] for outcome in outcomes] == [[4, 0], [2, 0], [2, 0]]
    assert toy_run(table, tmp_path / "parts", "slow,toy")[:2] == [0, 8]
    assert toy_run(table, tmp_path / "whole", "slow,toy")[:2] == [8, 0]
    assert comparable(tmp_path / "parts") == comparable(tmp_path / "whole")
    assert Store(tmp_path / "parts").run().provenance.command == "handbench"
    assert not leftovers(tmp_path / "parts")


def test_who_waits_takes_over_from_a_process_that_is_killed(toys, toy_table, tmp_path):
    from toyruns import ToyRun

    table = toy_table()
    first = ToyRun(table, tmp_path / "run", "slow")
    wait_for(lambda: trainings(toys))
    second = ToyRun(table, tmp_path / "run", "slow")
    wait_for(lambda: len(trainings(toys)) == 2)
    (toys / "go-1").touch()  # the second is through with its training, of seed 1, and waits for that of seed 0
    wait_for(lambda: len(list((tmp_path / "run").glob("cells/*.json"))) == 2)
    time.sleep(1.0)
    assert second.process.is_alive() and len(trainings(toys)) == 2
    first.process.kill()
    first.process.join()
    wait_for(lambda: len(trainings(toys)) == 3)
    (toys / "go").touch()
    assert second.told(PATIENCE) == [4, 0, []]
    assert not leftovers(tmp_path / "run")


def test_a_crash_is_tried_once_by_processes_that_share_a_run(toys, toy_table, tmp_path):
    """Who waited for a training that failed takes its cells as they are."""
    from toyruns import ToyRun

    table = toy_table()
    both = [ToyRun(table, tmp_path / "run", "fails") for _ in range(2)]
    outcomes = [each.told(PATIENCE) for each in both]
    assert all(len(outcome[2]) == 4 and "no such layer" in outcome[2][0] for outcome in outcomes)
    assert 2 <= len(trainings(toys)) <= 4  # a process that begins when the other is through tries again, as it should


def test_extra_methods_are_known_to_this_run_alone(toys, toy_protocol, tmp_path):
    from clusterfakes import METHODS

    protocol = toy_protocol(methods=["mean"])
    with pytest.raises(InputError, match="there is a method 'mean' already"):
        run(protocol, out=tmp_path, extra=[METHODS["toy"].__class__("mean", "clusterfakes:toy", "")])
    with pytest.raises(InputError, match="unknown method 'toy'"):
        run(protocol, ["toy"], out=tmp_path)
    outcome = run(protocol, ["toy"], out=tmp_path / "run", extra=[METHODS["toy"]])
    assert outcome.computed == 2
    assert Store(tmp_path / "run").run().provenance.plugins.keys() >= {"benchfakes", "clusterfakes"}


# --- a cluster ------------------------------------------------------------------------------------------------------


def test_without_ray_one_sentence_says_what_to_install(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "ray", None)
    assert main(["run", "smoke", "--executor", "ray"]) == 2
    said = "handbench: the executor ray needs Ray; install it with: pip install 'handbench[ray]'\n"
    assert capsys.readouterr().err == said
    assert main(["run", "smoke", "--executor", "rye"]) == 2
    assert capsys.readouterr().err == "handbench: unknown executor 'rye'; did you mean 'ray'?\n"
    assert main(["run", "smoke", "--cpus", "2"]) == 2
    assert "--executor ray" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.fixture
def job(
    toys: Path, toy_protocol: Callable[..., Protocol], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Job]:
    from clusterfakes import METHODS

    # a task sets both for good, its process is a node's; torch is loaded first, which reads the environment then
    monkeypatch.setattr("torch.set_num_threads", lambda count: None)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    cluster._site.cache_clear()
    yield Job(toy_protocol(), ("toy",), None, None, tmp_path / "run", None, ("handbench",), (METHODS["toy"],))
    cluster._site.cache_clear()


def test_a_job_travels_and_a_node_must_see_the_run_folder(job, monkeypatch):
    assert pickle.loads(pickle.dumps(job)) == job and hash(job)
    monkeypatch.setattr(cluster, "_PATIENCE", 0.1)
    with pytest.raises(InputError, match=r"node \S+ does not see the run folder .* all nodes share"):
        cluster._task(job, "cpu", 1, None, ["key"])


def test_a_node_with_other_software_is_told(job, monkeypatch):
    from handbench.bench import plan

    outcome = run(job.protocol, out=job.folder, extra=job.extra)
    key = Store(outcome.folder).run().cells[0]
    assert cluster._task(job, "cpu", 1, None, [key]) == [key]
    cluster._site.cache_clear()
    monkeypatch.setattr(plan, "__version__", "99.0")
    with pytest.raises(InputError, match="other software, plug-ins or data"):
        cluster._task(job, "cpu", 1, None, [key])


def test_a_cluster_that_is_not_there_is_told_at_once(toys, toy_protocol, tmp_path, monkeypatch):
    from clusterfakes import METHODS

    pytest.importorskip("ray", reason="ray is not installed: pip install 'handbench[ray]'")
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:1")
    with pytest.raises(
        InputError, match=r"the Ray cluster at RAY_ADDRESS=127\.0\.0\.1:1 cannot be reached \(.*refused"
    ):
        run(toy_protocol(), ["toy"], out=tmp_path / "run", extra=[METHODS["toy"]], executor="ray")


@pytest.fixture
def nodes(toys: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A cluster of two nodes of one core each, on this machine."""
    ray = pytest.importorskip("ray", reason="ray is not installed: pip install 'handbench[ray]'")
    from ray.cluster_utils import Cluster

    often = {"RAY_health_check_period_ms": "300"}  # five refusals are a dead node, by default after ten seconds
    quiet = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled", "OMP_NUM_THREADS": "1"}
    for name, value in {**often, **quiet}.items():
        monkeypatch.setenv(name, value)
    small = {"object_store_memory": 80 * 2**20, "include_dashboard": False}
    alone = {"no_monitor": True, "include_log_monitor": False}  # nobody adds nodes by need or reads what workers print
    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, **alone, **small})
    try:
        made.workers = [made.add_node(wait=False, num_cpus=1, **small) for _ in range(2)]
        made.wait_for_nodes(PATIENCE)
        monkeypatch.setenv("RAY_ADDRESS", made.address)
        yield made
    finally:
        ray.shutdown()
        made.shutdown()


@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")  # Ray starts its processes by one, JAX warns of any
def test_a_cluster_that_loses_a_node_makes_the_run_that_one_process_makes(
    nodes, toys, toy_protocol, tmp_path, monkeypatch
):
    from clusterfakes import METHODS

    protocol, names = toy_protocol(), ("slow", "toy", "fails")
    extra = [METHODS[name] for name in names]

    def disaster() -> None:
        (trainer,) = wait_for(lambda: [name for name in trainings(toys) if name.endswith("-0")])
        wait_for(lambda: len(list((tmp_path / "cluster").glob("cells/*.json"))) >= 2)  # the other node is at work too
        above = set()
        pid = int(trainer.removesuffix("-0"))
        while pid > 1:
            above.add(pid)
            pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
        (node,) = [n for n in nodes.workers if {p.process.pid for ps in n.all_processes.values() for p in ps} & above]
        nodes.remove_node(node, allow_graceful=False)
        wait_for(lambda: len([name for name in trainings(toys) if name.endswith("-0")]) == 2)
        (toys / "go").touch()

    killer = threading.Thread(target=disaster)
    killer.start()
    outcome = run(protocol, names, out=tmp_path / "cluster", extra=extra, executor="ray", command=["handbench"])
    killer.join(timeout=60)
    assert not killer.is_alive()
    assert (outcome.computed, outcome.reused) == (6, 0)
    assert len(outcome.crashed) == 2 and "no such layer" in outcome.crashed[0]
    assert len(list((tmp_path / "cluster").glob("cells/*.json"))) == 6 and not leftovers(tmp_path / "cluster")
    assert len([name for name in trainings(toys) if name.startswith("fails")]) == 1, "tried once, for all subjects"
    assert {cell["device"]["threads"] for cell in cells(tmp_path / "cluster")} == {1}
    (toys / "go").touch()
    run(protocol, names, out=tmp_path / "local", extra=extra, command=["handbench"])
    assert untraced(tmp_path / "cluster") == untraced(tmp_path / "local")

    monkeypatch.setattr(cluster, "_RETRIES", 1)
    lost = run(protocol, ["deadly"], out=tmp_path / "deadly", extra=[METHODS["deadly"]], executor="ray")
    assert lost.computed == 0 and len(lost.crashed) == 2
    assert lost.crashed[0].startswith("deadly s01 seed 0: its worker was lost 2 times (WorkerCrashedError)")
    with pytest.raises(InputError, match=r"has 3 cores, the most is 1; choose fewer with --cpus"):
        run(protocol, ["toy"], out=tmp_path / "wide", extra=[METHODS["toy"]], executor="ray", cpus=3)


def untraced(folder: Path) -> str:
    """A run without tracebacks, which name lines of the process that computed."""
    told, kept = json.loads(comparable(folder))
    return json.dumps([told, [{**cell, "error": bool(cell["error"])} for cell in kept]])
