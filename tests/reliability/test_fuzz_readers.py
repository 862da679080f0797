"""Spoilt files of every kind are read or refused by name: no crash, no hang, no greed."""

import time

import fuzz_clouds
import fuzz_photos
import fuzz_tables
import numpy as np
import pytest
from fuzz_bench import SPARE_MB, Bench, Reader, fuzz, valid_files

from cherrypicker.errors import StageError

READERS = [*fuzz_clouds.READERS, *fuzz_tables.READERS, *fuzz_photos.READERS]
# Some seconds a reader
N_FILES = 50


@pytest.fixture(scope="module")
def bench():
    bench = Bench()
    yield bench
    bench.stop()


@pytest.mark.parametrize("reader", READERS, ids=str)
def test_files_that_are_not_spoilt_are_read(bench, tmp_path, reader):
    for path, _ in valid_files(reader, tmp_path / "files"):
        assert bench.look(reader.read, path)[:1] == ("read",), path.name


@pytest.mark.parametrize("reader", READERS, ids=str)
def test_a_spoilt_file_is_read_or_refused_by_name(bench, tmp_path, reader):
    fuzz(bench, reader, tmp_path / "files", n_files=N_FILES)


@pytest.mark.fuzz
@pytest.mark.parametrize("reader", READERS, ids=str)
def test_spoilt_files_for_as_long_as_asked(bench, tmp_path, reader):
    fuzz(bench, reader, tmp_path / "files")


def _fails(path):
    return path.read_bytes()[1000]


def _refuses(path):
    raise StageError("no such thing", file=path)


def _is_unclear(path):
    raise StageError("something is wrong")


def _dies(path):
    import os
    import signal

    os.kill(os.getpid(), signal.SIGSEGV)


def _hangs(path):
    time.sleep(60)


def _takes_memory(path):
    return np.ones((2 * SPARE_MB) << 17).sum()


@pytest.mark.parametrize(
    ("read", "fault"),
    [
        (_refuses, ""),
        (_fails, "crash: "),
        (_is_unclear, "unclear: "),
        (_dies, "died: "),
        (_takes_memory, "memory: "),
    ],
)
def test_the_bench_tells_faults(bench, tmp_path, read, fault):
    told = bench.faults(Reader("", read, lambda folder: []), tmp_path / "a", b"content")
    assert told.startswith(fault) and bool(told) == bool(fault)


def test_the_bench_tells_a_hang(bench, tmp_path):
    assert bench.look(_hangs, tmp_path / "a", hang_s=0.5)[0] == "hangs"
