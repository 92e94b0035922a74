"""Which LLVM works is remembered; that one failed once is not."""

from __future__ import annotations

import pytest

from handbench.data.openstage.trace import llvm


def test_a_failed_probe_is_tried_again_and_a_good_one_is_kept(tmp_path, monkeypatch):
    library = tmp_path / "libLLVM.so.19"
    library.write_text("")
    works = {str(library): False}
    probes = []
    monkeypatch.setenv("HANDBENCH_DATA", str(tmp_path / "cache"))
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "")
    monkeypatch.setattr(llvm, "_candidates", lambda: [str(library)])
    monkeypatch.setattr(llvm, "_works", lambda path: probes.append(path) or works[path])
    assert llvm.choose_variant() == llvm.SCALAR
    works[str(library)] = True
    assert llvm.choose_variant() == llvm.VECTORISED, "the machine was busy, now it is not"
    assert llvm.choose_variant() == llvm.VECTORISED
    assert len(probes) == 2, "what works is not tried again"


@pytest.mark.parametrize("text", ["{", '{"old": false}', "3"])
def test_a_foreign_cache_file_is_ignored(tmp_path, monkeypatch, text):
    monkeypatch.setenv("HANDBENCH_DATA", str(tmp_path))
    (tmp_path / "llvm-works.json").write_text(text)
    assert llvm._read_proven() == []
