"""Spoils valid files and looks at what a reader makes of them, in a process of its own.

A reader may take a spoilt file or refuse it by a `StageError` that names the file or the key.
Another error, a process that dies, one that hangs, and memory that the file's size does not explain
are faults.
"""

import ctypes
import os
import re
import resource
import struct
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from snakemake_fork import FORKED, start_what_is_forked

from cherrypicker.errors import LONGEST_CAUSE, StageError

SECONDS_KEY = "CHERRYPICKER_FUZZ_S"
HANG_S = 60.0  # the slowest spoilt file of a reader takes 0.6 s, 10 beside four other jobs
START_S = 120.0
# What a reader may take beside the file: libraries that it loads at its first file among it
SPARE_MB = 96
# Bytes of memory a byte of the file: text in Python's own lists takes some 60
BYTES_A_BYTE = 200
ADDRESS_SPACE = 16 << 30  # a stop before the machine's own

_NUMBERS = (0, 1, 2, 3, 255, 256, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63, 2**64 - 1)
_FLOATS = (float("nan"), float("inf"), -1.0, 1e300, 5e-324)
_WORDS = (
    *(b"", b"0", b"-1", b"1.5", b"nan", b"inf", b"1e999", b"-0", b"99999999999999999999"),
    *(b"9" * 5000, b"true", b"null", b"~", b"{}", b"[]", b"[[]]", b'"', b"'", b"\xff", b"\0"),
    *(b"0x1F", b"1_000", "٣".encode(), "²".encode(), b"2026-02-30", b"&a"),
    *(b"*a", b"<<", b"!!set", b"1:" * 300 + b"1.5"),
    *(b"\n", b"\r", b"\t", b",", b";", b":", b"- ", b"?", b"#", b"<a>", b"\x85", "\u2028".encode()),
)


@dataclass(frozen=True)
class Reader:
    """What reads a kind of file, and how valid ones are made."""

    name: str
    # Of a file's path; a function of a module, which the other process finds by its name
    read: Callable[[Path], object]
    # Writes valid files into a folder; those that it returns are spoilt, one at a time
    make: Callable[[Path], list[Path]]
    bytes_a_byte: int = BYTES_A_BYTE
    needs: str = ""  # a package that it does not work without

    def __str__(self) -> str:
        return self.name


def spoil(content: bytes, random) -> bytes:
    """Return a file's content with one to five faults, or bytes of chance alone.

    Parameters
    ----------
    random : random.Random
        Hypothesis' own in tests, so that a finding is made small.
    """
    if random.random() < 0.03:
        return random.randbytes(random.randrange(200))
    for _ in range(random.randrange(1, 6)):
        content = random.choice(_FAULTS)(content, random)
    return content


def _place(content: bytes, random) -> int:
    """A place in a file; in every other case in its head."""
    n = len(content)
    return random.randrange(min(n, 300) + 1 if random.random() < 0.5 else n + 1)


def _cut(content: bytes, random) -> bytes:
    return content[: random.randrange(len(content) + 1)]


def _drop(content: bytes, random) -> bytes:
    at = _place(content, random)
    return content[:at] + content[at + random.choice((1, 2, 4, 16, 100)) :]


def _copy(content: bytes, random) -> bytes:
    first, to = _place(content, random), _place(content, random)
    piece = content[first : first + random.choice((1, 4, 16, 100, 1000))]
    return content[:to] + piece + content[to:]


def _flip(content: bytes, random) -> bytes:
    at = _place(content, random)
    return content[:at] + bytes([random.randrange(256)]) + content[at + 1 :]


def _number(content: bytes, random) -> bytes:
    """Put a telling number of any width over a place."""
    at = _place(content, random)
    if random.random() < 0.2:
        raw = struct.pack(random.choice(("<f", "<d")), min(random.choice(_FLOATS), 1e38))
    else:
        width = random.choice((1, 2, 4, 8))
        raw = random.choice(_NUMBERS).to_bytes(16, "little")[:width]
        raw = raw if random.random() < 0.7 else raw[::-1]
    return content[:at] + raw + content[at + len(raw) :]


def _word(content: bytes, random) -> bytes:
    """Put another word in the place of a number or a word of a text, or of its file's head."""
    words = list(re.finditer(rb"[\w.+-]+", content[:20_000]))
    if not words:
        return content
    found = random.choice(words)
    other = random.choice(words)[0] if random.random() < 0.3 else random.choice(_WORDS)
    return content[: found.start()] + other + content[found.end() :]


def _line(content: bytes, random) -> bytes:
    """Take a line out, or bring another one in its place."""
    lines = content.split(b"\n")
    at = random.randrange(len(lines))
    lines[at : at + 1] = [lines[random.randrange(len(lines))]] * random.choice((0, 1, 2))
    return b"\n".join(lines)


_FAULTS = (_cut, _drop, _copy, _flip, _flip, _number, _number, _word, _word, _word, _line)


class Bench:
    """A process that reads files for the tests, started anew where it dies or hangs."""

    def __init__(self) -> None:
        self._process = None

    def look(
        self, read: Callable[[Path], object], path: Path, hang_s: float = HANG_S
    ) -> tuple[str, str, float]:
        """Return what became of reading a file.

        Returns
        -------
        kind : {"read", "refused", "unclear", "crash", "died", "hangs"}
        text : str
            The message, or the traceback.
        taken_mb : float
            By how much the process's memory grew meanwhile.
        """
        self._start()
        self._pipe.send((read, path))
        try:
            if self._pipe.poll(hang_s):
                return self._pipe.recv()
            kind, text = "hangs", f"no answer in {hang_s:g} s"
        except EOFError:
            self._process.join()
            kind, text = "died", f"the process ended with {self._process.exitcode}"
        self.stop()
        return kind, text, 0.0

    def faults(self, reader: Reader, path: Path, content: bytes) -> str:
        """Return what is wrong with how a reader takes a file; empty for nothing."""
        path.write_bytes(content)
        kind, text, taken_mb = self.look(reader.read, path)
        if kind not in ("read", "refused"):
            return f"{kind}: {text}"
        allowed = SPARE_MB + reader.bytes_a_byte * len(content) / 1e6
        if taken_mb > allowed:
            return f"memory: {taken_mb:.0f} MB for a file of {len(content):,} bytes ({text})"
        return ""

    def stop(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            self._process = None

    def _start(self) -> None:
        if self._process is not None:
            return
        start_what_is_forked()
        self._pipe, theirs = FORKED.Pipe()
        self._process = FORKED.Process(target=_serve, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()
        self._pipe.send((_nothing, None))
        assert self._pipe.poll(START_S), "the process for the readers does not start"
        self._pipe.recv()


def _nothing(path: Path) -> None:
    return None


def _serve(pipe) -> None:
    """Read files until the pipe is closed."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # what libraries print of broken files
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    trim = getattr(ctypes.CDLL(None), "malloc_trim", lambda spare: 0)
    while True:
        try:
            read, path = pipe.recv()
        except EOFError:
            return
        trim(0)
        before = _mark_memory()
        try:
            kind, text = "read", repr(type(read(path)))
        except StageError as error:
            kind, text = _judged(error)
        except BaseException:
            kind, text = "crash", traceback.format_exc()[-4000:]
        pipe.send((kind, text, _peak_mb() - before))


def _judged(error: StageError) -> tuple[str, str]:
    """Whether an error tells a user what to do: where it is, on a line that can be read."""
    text = str(error)
    if error.file is None and error.key is None:
        return "unclear", f"neither file nor key: {text}"
    if len(error.cause) > 2 * LONGEST_CAUSE:
        return "unclear", f"a cause of {len(error.cause):,} characters: {text[:200]} ..."
    if not text.isprintable():
        return "unclear", f"a cause that a terminal would obey: {text!r}"
    return "refused", text


def _mark_memory() -> float:
    """Forget the process's peak so far; return its memory now, MB. Linux only, 0 elsewhere."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return _peak_mb()
    return _peak_mb()


def _peak_mb() -> float:
    try:
        text = Path("/proc/self/status").read_text()
    except OSError:
        return 0.0
    return int(re.search(r"VmHWM:\s+(\d+) kB", text)[1]) / 1e3


def valid_files(reader: Reader, folder: Path) -> list[tuple[Path, bytes]]:
    """Write a reader's valid files; return those to spoil with their content."""
    if reader.needs:
        pytest.importorskip(reader.needs)
    folder.mkdir(parents=True, exist_ok=True)
    return [(path, path.read_bytes()) for path in reader.make(folder)]


def fuzz(bench: Bench, reader: Reader, folder: Path, *, n_files: int = 0) -> None:
    """Spoil a reader's files again and again, and assert that it takes or refuses each.

    Parameters
    ----------
    n_files : int
        How many, the same ones at every call; 0 for other ones until ``$CHERRYPICKER_FUZZ_S``
        seconds, 60 unless told, are over; how many they were is printed (``pytest -rP``).
    """
    hypothesis = pytest.importorskip("hypothesis", reason="HYPOTHESIS MISSING")
    strategies = hypothesis.strategies
    files = valid_files(reader, folder)
    n_looked = 0

    def is_sound(random, at: int) -> None:
        nonlocal n_looked
        n_looked += 1
        path, content = files[at % len(files)]
        spoilt = spoil(content, random)
        try:
            fault = bench.faults(reader, path, spoilt)
        finally:
            path.write_bytes(content)
        assert not fault, f"{path.name}, {len(spoilt)} bytes {spoilt[:2000]!r}: {fault}"

    def run(n: int, seed: int | None) -> None:
        settings = hypothesis.settings(
            max_examples=n,
            derandomize=seed is None,
            deadline=None,
            database=None,
            suppress_health_check=list(hypothesis.HealthCheck),
        )
        given = hypothesis.given(
            strategies.randoms(use_true_random=False), strategies.integers(0, len(files) - 1)
        )
        test = settings(given(is_sound))
        (test if seed is None else hypothesis.seed(seed)(test))()

    if n_files:
        run(n_files, None)
        return
    seconds, seed = float(os.environ.get(SECONDS_KEY, "60")), 0
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        run(200, seed)
        seed += 1
    print(f"{reader}: {n_looked:,} spoilt files in {seconds:g} s")
