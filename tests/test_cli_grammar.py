"""One grammar for all verbs: help with examples, JSON on request, names that complete."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
from collections.abc import Iterator

import pytest

from handbench.cli import main, parser

_PAGES = {"completion", "view"}  # their answer is a script, or a window


def leaves(root: argparse.ArgumentParser, above: str = "") -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Every verb that does something, by its words."""
    inner = [action for action in root._actions if isinstance(action, argparse._SubParsersAction)]
    if not inner:
        yield above, root
    for action in inner:
        for name, verb in action.choices.items():
            yield from leaves(verb, f"{above} {name}".strip())


VERBS = dict(leaves(parser()))


def option_names(verb: argparse.ArgumentParser) -> set[str]:
    return {name for action in verb._actions for name in action.option_strings}


@pytest.mark.parametrize("verb", VERBS)
def test_every_option_is_explained_and_every_verb_has_an_example(verb):
    found = VERBS[verb]
    assert not [action.dest for action in found._actions if not action.help]
    assert "examples:" in (found.epilog or "") and f"handbench {verb}" in found.epilog


@pytest.mark.parametrize("verb", [verb for verb in VERBS if verb not in _PAGES])
def test_every_verb_answers_in_json(verb):
    assert "--json" in option_names(VERBS[verb])


def test_one_thing_has_one_name():
    """Where captures are kept, which methods, which seeds: the same flag for every verb that takes it."""
    named = {name for verb in VERBS.values() for name in option_names(verb)}
    assert not named & {"--method", "--dataset", "--output", "--verbose"}
    for verb, found in VERBS.items():
        if any("where captures are kept" in (action.help or "") for action in found._actions):
            assert "--data" in option_names(found), verb


@pytest.mark.parametrize("verb", VERBS)
def test_examples_can_be_parsed(verb):
    """Each example is a command that the parser takes."""
    import shlex

    text = VERBS[verb].epilog.partition("examples:\n")[2].partition("\n\n")[0]
    for line in text.splitlines():
        words = shlex.split(line.split("  #")[0].strip().split("  ")[0])
        words = words[: next((i for i, word in enumerate(words) if word.startswith(">")), None)]
        parser().parse_args(words[1:])


def test_a_bare_command_is_help(capsys):
    assert main([]) == 0
    assert "examples:" in capsys.readouterr().out


def test_lists_and_settings_in_json(capsys):
    assert main(["list", "protocols", "--json"]) == 0
    assert "quick" in json.loads(capsys.readouterr().out)["protocols"]
    assert main(["settings", "phong", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["phong"]
    assert told["set"] and told["settings"]["texture"] == 128
    assert main(["settings", "phong"]) == 0
    assert "roughness          0.25,0.35" in capsys.readouterr().out


def test_the_cache_is_listed_and_cleaned_by_name(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("HANDBENCH_DATA", str(tmp_path))
    (tmp_path / "shadows").mkdir()
    (tmp_path / "shadows" / "a.shadows").write_bytes(b"x" * 2500)
    (tmp_path / "digests.json").write_text("{}")
    assert main(["cache"]) == 0
    out = capsys.readouterr().out
    assert f"{tmp_path}: 2.5 kB" in out and "shadows" in out
    assert main(["cache", "--clean"]) == 2 and main(["cache", "shadwos", "--clean"]) == 2
    assert "did you mean 'shadows'" in capsys.readouterr().err and (tmp_path / "shadows").is_dir()
    assert main(["cache", "shadows", "--clean", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["removed"] == 2500
    assert sorted(path.name for path in tmp_path.iterdir()) == ["digests.json"]


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_bash_completes_verbs_protocols_and_options(capsys, tmp_path):
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "handbench"
    script.write_text(capsys.readouterr().out)

    def completed(*words: str) -> set[str]:
        line = " ".join(f"'{word}'" for word in words)
        code = f"source {script}; COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _shtab_handbench; "
        code += 'printf "%s\\n" "${COMPREPLY[@]}"'
        done = subprocess.run(
            ["bash", "-c", code], capture_output=True, text=True, check=False, env={**os.environ, "HOME": str(tmp_path)}
        )
        return set(done.stdout.split())

    assert {"run", "report"} <= completed("handbench", "r")
    assert "quick" in completed("handbench", "run", "qui")
    assert "--methods" in completed("handbench", "run", "--me")
