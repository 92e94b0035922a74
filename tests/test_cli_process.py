"""The ends of the process `handbench`: its streams, its signals, its exit codes."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from handbench import terminal
from handbench.cli import main
from handbench.cli.endings import ending
from handbench.cli.process import Output
from handbench.errors import InputError, StorageError

FULL = Path("/dev/full")
full_disk = pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full, a disk that is always full")


def _process(body: str, shell: str = "", **environment: str) -> subprocess.CompletedProcess[str]:
    """`handbench` as a process whose `main` is `body`, with redirections of a shell."""
    code = f"import sys, os, signal, atexit, handbench.cli as cli\ndef main(argv=None, stops=None):\n{body}\n"
    code += "cli.main = main\ncli.command()\n"
    command = ["sh", "-c", f'"$0" -c "$1" {shell}', sys.executable, code]
    env = {**os.environ, **environment}
    env.pop("PYTHONUNBUFFERED", None)  # so that the end finds something to write
    return subprocess.run(
        command, capture_output=True, text=True, check=False, env=env, errors="surrogateescape", timeout=120
    )


def test_a_command_ends_at_once_with_its_code_and_all_it_printed():
    body = """
    class Slow:
        def __del__(self): print('taken apart')
    global slow
    slow = Slow()
    atexit.register(print, 'asked for')
    print('done')
    return 3"""
    done = _process(body)
    assert (done.returncode, done.stdout) == (3, "done\nasked for\n")


@pytest.mark.parametrize("code", [0, 1, 3])
@pytest.mark.parametrize("body", ["print('so far')", "[print('line', i, flush=True) for i in range(20_000)]"])
def test_a_reader_that_leaves_changes_no_code(code, body):
    """A gate whose output goes into `true` must not look like a regression, nor hide one."""
    reader = subprocess.Popen(["true"], stdin=subprocess.PIPE)
    assert reader.wait() == 0 and reader.stdin is not None
    program = f"import handbench.cli as cli\ndef main(stops):\n    {body}\n    return {code}\n"
    program += "cli.main = main\ncli.command()\n"
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, stdout=reader.stdin, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (code, "")


@full_disk
@pytest.mark.parametrize(("code", "told"), [(0, 2), (1, 1), (2, 2)])
def test_a_full_disk_behind_the_output_is_one_sentence(code, told):
    done = _process(f"    print('so far')\n    return {code}", "> /dev/full")
    assert done.returncode == told
    assert done.stderr.count("\n") == 1 and "standard output cannot be written (No space left" in done.stderr


@pytest.mark.parametrize("shell", [">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-", "2>/dev/full", "| cat >/dev/null"])
def test_streams_that_are_closed_or_full_fail_no_command(shell, tmp_path):
    file = tmp_path / "made"
    body = f"    open({str(file)!r}, 'w').write('own'); print('text'); print('wrong', file=sys.stderr); return 0"
    done = _process(body, shell)
    assert done.returncode == 0 and "Traceback" not in done.stderr
    assert file.read_text() == "own", "what is printed never lands in a file that happens to be opened"


def test_a_method_that_closes_the_output_takes_no_answer_along():
    body = "    sys.stdout.close(); sys.stderr.close(); print('answer'); print('told', file=sys.stderr); return 0"
    done = _process(body)
    assert (done.returncode, done.stdout, done.stderr) == (0, "answer\n", "told\n")


def test_a_file_never_becomes_the_standard_output(tmp_path):
    file = tmp_path / "made"
    body = f"    global kept\n    kept = open({str(file)!r}, 'w')\n    os.write(1, b'text')\n    return 0"
    assert _process(body, ">&-").returncode == 0
    assert file.read_text() == ""


@pytest.mark.parametrize(
    "environment",
    [
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        {"PYTHONIOENCODING": "ascii"},
        {"PYTHONIOENCODING": "latin-1"},
        {"PYTHONIOENCODING": "utf-8:strict"},
        {"PYTHONIOENCODING": "cp037"},
        {"LANG": "no_SUCH.locale"},
    ],
)
def test_every_text_can_be_printed_in_every_encoding(environment):
    body = """
    from handbench.terminal import say, show
    from rich.table import Table
    for text in map(chr, (0x2191, 0xe4, 0x1f590, 0xdcff, 0xd800)):
        say(text)
        print(text, file=sys.stderr)
        table = Table(title=text)
        table.add_row(text)
        show(table)
    return 0"""
    done = _process(body, **environment)
    assert done.returncode == 0 and "Traceback" not in done.stderr


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_signals_stop_a_command_in_order(name, code):
    body = f"""
    try:
        os.kill(os.getpid(), signal.{name})
        signal.pause()
    except BaseException as error:
        from handbench.cli.endings import ending
        return ending(RuntimeError('what a library made of it'), False, stops.signal)
    finally:
        print('tidied')"""
    done = _process(body)
    assert (done.returncode, done.stdout, done.stderr) == (code, "tidied\n", "handbench: stopped\n")


def test_a_signal_that_is_ignored_stays_ignored():
    code = 'trap \'\' HUP; exec "$0" -c "$1"'
    body = "import os, signal, handbench.cli as c\n"
    body += "c.main = lambda stops: os.kill(os.getpid(), signal.SIGHUP) or 0\nc.command()"
    assert subprocess.run(["sh", "-c", code, sys.executable, body], check=False).returncode == 0


def test_an_interrupt_while_modules_are_loaded_is_no_traceback():
    code = "import os, signal, sys, handbench.cli as cli\nclass Early:\n    def find_spec(self, name, *more):\n"
    code += "        if name == sys.argv[1]: os.kill(os.getpid(), signal.SIGINT)\n"
    code += "sys.meta_path.insert(0, Early())\ncli.command()\n"
    for module in ("handbench.cli.process", "handbench.cli.run", "handbench.terminal"):
        done = subprocess.run([sys.executable, "-c", code, module], capture_output=True, text=True, check=False)
        assert done.returncode == 130 and "Traceback" not in done.stderr, module


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (InputError("no\nsuch \x1b[31mthing"), 2, "handbench: no such ␛[31mthing\n"),
        (StorageError("cannot be written"), 2, "handbench: cannot be written\n"),
        (MemoryError(), 2, "there is not enough memory"),
        (OSError(28, "No space left on device"), 2, "a disk is full"),
        (PermissionError(13, "Permission denied", "/x/y"), 2, "/x/y cannot be used (Permission denied)"),
        (KeyError("x"), 70, "a fault of handbench itself (KeyError: 'x')"),
        (RecursionError("deep"), 70, "a fault of handbench itself (RecursionError: deep)"),
        (SystemExit(0), 70, "a fault of handbench itself (SystemExit: 0)"),
        (ValueError("y" * 10_000), 70, "a fault of handbench itself"),
    ],
)
def test_every_error_is_one_sentence_with_a_code(error, code, text, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert ending(error, False, None) == code
    err = capsys.readouterr().err
    assert text in err and err.count("\n") == 1 and len(err) < 5000
    reports = list(tmp_path.iterdir())
    assert bool(reports) == (code == 70)
    if reports:
        assert type(error).__name__ in reports[0].read_text() and str(reports[0]) in err


def test_a_fault_in_a_verb_is_told_as_such(monkeypatch, capsys, tmp_path):
    def fail(*arguments: object) -> None:
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("handbench.bench.run.find_protocol", fail)
    assert main(["run", "smoke"]) == 70
    assert "a fault of handbench itself (ZeroDivisionError: oh)" in capsys.readouterr().err


def test_no_text_is_a_command_to_the_terminal(capsys):
    from rich.table import Table
    from rich.text import Text

    hostile = "a\x1b[31mb\x9b31m\x07\r\x7f\u202eend[/unseen] [red]:hand:"
    table = Table(title=hostile)
    table.add_column(hostile)
    table.add_row(Text(hostile))
    terminal.show(table)
    terminal.show(Text(hostile, style="red"))
    terminal.say(hostile)
    terminal.complain(hostile)
    told = "".join(capsys.readouterr())
    assert not set("\x1b\x9b\x07\r\x7f\u202e") & set(told)
    assert told.count("[/unseen]") >= 2 and "␛[31mb�31m␇␍␡�" in told


def test_argument_errors_repeat_without_obeying(capsys):
    for command in (["list", "\x1b[31m"], ["list", "methods", "\x1b[2J"], ["run", "x", "--cpus", "\x1b"]):
        with pytest.raises(SystemExit):
            main(command)
        assert "\x1b" not in capsys.readouterr().err


def test_an_output_waits_for_a_slow_reader():
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    output = io.BufferedWriter(Output(writer))
    child = subprocess.Popen(
        [sys.executable, "-c", "import sys; print(len(sys.stdin.read()))"], stdin=reader, stdout=-1
    )
    os.close(reader)
    output.write(b"x" * 1_000_000)
    output.flush()
    os.close(writer)
    assert child.communicate()[0] == b"1000000\n"


def test_a_folder_that_is_gone_is_told(tmp_path):
    (tmp_path / "gone").mkdir()
    line = f"cd {tmp_path}/gone && rmdir ../gone && {sys.executable} -m handbench.cli list"
    done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1) and "the current folder is gone" in done.stderr
