"""Mutated files for every reader of files: `python -m tests.fuzz.run --cases 100000`.

Each must end as an object or as BadInput in one line, with nothing printed and no warning, within a limit of time and
of memory. The cases run in processes of their own, one a core: one that crashes or hangs is reported like any other.

    python -m tests.fuzz.run --seed 3 --case asset:1207                 repeats one case, with its traceback
    python -m tests.fuzz.run --seed 3 --case asset:1207 --keep FOLDER   and keeps its file
"""

import argparse
import contextlib
import faulthandler
import multiprocessing
import os
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections import Counter
from datetime import date
from pathlib import Path
from queue import Empty, SimpleQueue

from core.errors import BadInput
from tests.fuzz.targets import TARGETS, Target, mutated, sound_samples, write

CPU_SECONDS_MAX = 5.0  # of a case; sound files take milliseconds
WALL_SECONDS_MAX = 120.0  # after which its process is ended: it hangs
MEMORY_MAX = 1 << 30  # [bytes] by which a case may raise the peak: 64 MiB of data (UNPACK_BASE), in float64, and copies
ADDRESS_SPACE = 8 << 30  # [bytes] more than the program itself takes
NOT_STARTED = -1  # instead of a case's number
CHUNK = 100  # cases that a process takes at a time


def outcome(target: Target, seed: int, number: int, folder: Path) -> str:
    """The outcome of a case: "read", "refused", or what is wrong. Raises what the reader raises, if not BadInput."""
    files = mutated(target, seed, number, folder)
    write(folder, files)
    path, peak, cpu = folder / next(iter(files)), reset_peak(), time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            target.read(path)
        found = "read"
    except BadInput as e:
        found, text = "refused", str(e)
        if "\n" in text or str(folder) not in text or len(text) > len(str(path)) + 1000:
            found = f"wrong: the message is not one line that names the file: {text[:300]!r}"
    finally:
        for name in files:
            with contextlib.suppress(OSError):
                (folder / name).unlink()
    took, more = time.process_time() - cpu, reset_peak() - peak
    if took > CPU_SECONDS_MAX:
        return f"wrong: took {took:.1f} s"
    return f"wrong: took {more / 1e6:.0f} MB" if more > MEMORY_MAX else found


def reset_peak() -> int:
    """The largest resident size since the last call [bytes]; 0 where the system does not say."""
    try:
        status = Path("/proc/self/status").read_text()
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return 0
    return 1024 * int(status.split("VmHWM:")[1].split()[0])


def wrong(target: Target, seed: int, number: int, folder: Path) -> str | None:
    """Faults in the outcome of a case, in lines; None if nothing is. Its outcome is noted in TALLY."""
    try:
        found = outcome(target, seed, number, folder)
    except Exception:
        found = "wrong: " + traceback.format_exc(limit=-6)
    TALLY[(target.name, found.split(":")[0])] += 1
    return found.removeprefix("wrong: ") if found.startswith("wrong") else None


TALLY: Counter = Counter()  # of this process, by target and "read", "refused" or "wrong"


def limit_memory() -> None:
    """Let allocations beyond ADDRESS_SPACE fail."""
    if sys.platform == "linux":
        import resource

        taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (taken + ADDRESS_SPACE,) * 2)


def work(pipe, current, said: str, names: list[str]) -> None:
    """A process: chunks of cases come through the pipe, what is wrong with them goes back."""
    os.environ["ENABLE_TAICHI_HEADER_PRINT"] = "False"
    import cv2

    cv2.setNumThreads(1)
    vars(sys.modules["__main__"]).update(__spec__=None, __file__=None)  # processes of readers need not import it
    with open(said, "w+b", buffering=0) as log, tempfile.TemporaryDirectory() as folder:
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
        for name in names:
            sound_samples(name, Path(folder))  # all modules are imported before memory is limited
        limit_memory()
        while (chunk := pipe.recv()) is not None:
            name, seed, first, count = chunk
            for number in range(first, first + count):
                current.value = number
                faulthandler.dump_traceback_later(WALL_SECONDS_MAX, exit=True)
                defect = wrong(TARGETS[name], seed, number, Path(folder))
                faulthandler.cancel_dump_traceback_later()
                if defect is None and (size := log.seek(0, 2)):
                    log.seek(0)
                    TALLY[(name, "wrong")] += 1
                    defect = f"printed {log.read(min(size, 1000)).decode(errors='replace')!r}"
                log.truncate(0)
                log.seek(0)
                if defect is not None:
                    pipe.send(("wrong", number, defect))
            pipe.send(("done", dict(TALLY), None))
            TALLY.clear()


class Fuzz:
    """Cases of targets, shared out among processes."""

    def __init__(self, seed: int, cases: dict[str, range]):
        self.seed, self.tally, self.failures, self._names = seed, Counter(), [], list(cases)
        self._planned = sum(map(len, cases.values()))
        self._chunks: SimpleQueue = SimpleQueue()
        starts = [(k, name) for name, numbers in cases.items() for k in numbers[::CHUNK]]
        for first, name in sorted(starts):
            self._chunks.put((name, first, min(CHUNK, cases[name].stop - first)))
        self._lock, self._context = threading.Lock(), multiprocessing.get_context("spawn")

    def run(self, jobs: int) -> None:
        """Run all cases in this many processes."""
        threads = [threading.Thread(target=self._lead) for _ in range(jobs)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def _lead(self) -> None:
        """Lead one process through chunks; where it dies, another one goes on with the next case."""
        with tempfile.NamedTemporaryFile() as said:
            process, pipe, current = self._start(said.name)
            while True:
                try:
                    name, first, count = self._chunks.get_nowait()
                except Empty:
                    break
                while count:
                    pipe.send((name, self.seed, first, count))
                    try:
                        while (message := pipe.recv())[0] == "wrong":
                            self._fail(name, message[1], message[2])
                        self._done(message[1])
                        count = 0
                    except (EOFError, OSError):
                        process.join()
                        text = Path(said.name).read_text(errors="replace")[-2000:]
                        if current.value == NOT_STARTED:
                            self._fail(name, first, f"the process did not start: {text}")
                            return
                        self._fail(name, current.value, f"ended its process (status {process.exitcode}): {text}")
                        first, count = current.value + 1, first + count - current.value - 1
                        process, pipe, current = self._start(said.name)
            pipe.send(None)
            process.join()

    def _start(self, said: str):
        pipe, far = self._context.Pipe()
        current = self._context.Value("q", NOT_STARTED)
        process = self._context.Process(target=work, args=(far, current, said, self._names))
        process.start()
        far.close()
        return process, pipe, current

    def _fail(self, name: str, number: int, defect: str) -> None:
        with self._lock:
            self.failures.append((name, number, defect))
            print(f"FAILED --seed {self.seed} --case {name}:{number}: {defect.strip()}", flush=True)

    def _done(self, tally: dict) -> None:
        with self._lock:
            before = 10 * self.tally.total() // self._planned
            self.tally.update(tally)
            if 10 * self.tally.total() // self._planned > before:
                print(f"{self.tally.total()} of {self._planned} cases", file=sys.stderr, flush=True)

    def table(self) -> list[str]:
        """Counts of each target, in lines."""
        names = dict.fromkeys(name for name, _ in self.tally)
        kinds = ("read", "refused", "wrong")
        lines = [f"{'':12}" + "".join(f"{kind:>10}" for kind in kinds)]
        return lines + [f"{name:12}" + "".join(f"{self.tally[name, kind]:>10}" for kind in kinds) for name in names]


def main() -> int:
    """Run the command line; exit status 1 if a reader failed."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--cases", type=int, default=100_000, help="of all targets together (default 100000)")
    p.add_argument("--seed", type=int, default=date.today().toordinal(), help="(default: another one each day)")
    p.add_argument("--target", choices=TARGETS, action="append", help="only these readers")
    p.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes (default: one a core)")
    p.add_argument("--case", metavar="TARGET:NUMBER", help="repeat one case in this process")
    p.add_argument("--keep", type=Path, metavar="FOLDER", help="--case: write its file there")
    args = p.parse_args()
    if args.case:
        name, number = args.case.split(":")
        with tempfile.TemporaryDirectory() as folder:
            if args.keep:
                write(args.keep, mutated(TARGETS[name], args.seed, int(number), Path(folder)))
            sound_samples(name, Path(folder))
            limit_memory()
            print(wrong(TARGETS[name], args.seed, int(number), Path(folder)) or "nothing is wrong")
        return 0
    names = args.target or list(TARGETS)
    begin, each = time.monotonic(), -(-args.cases // len(names))
    fuzz = Fuzz(args.seed, {name: range(each) for name in names})
    fuzz.run(args.jobs)
    print(*fuzz.table(), sep="\n")
    took = time.monotonic() - begin
    print(f"{each * len(names)} cases, seed {args.seed}, {took:.0f} s: {len(fuzz.failures)} failures")
    return int(bool(fuzz.failures))


if __name__ == "__main__":
    sys.exit(main())
