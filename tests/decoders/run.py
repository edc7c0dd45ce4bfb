"""`make fuzz-decoders`: fuzz every decoder of external bytes, and report the results.

    python tests/decoders/run.py --count 10000 --seed 1 [--only bundle,block] [--guided]

Each decoder is fuzzed in its own process with limited address space. An input that crashes it is written to
tests/decoders/found; `--again FILE` decodes it again. With `--guided` atheris (pip install it) selects the
inputs by their code coverage, and adds inputs with new coverage to the corpus.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import resource
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path

from decoder_corpus import corpus_of, keep

HERE = Path(__file__).parent
FOUND = HERE / "found"
#: Bytes of address space for a target in addition to those before its first input.
MEMORY_LIMIT = 512 << 20
#: Distinct crashes of one target that are reported before it is skipped.
MOST = 20
#: The most stored inputs with new coverage of one decoder, the shortest ones.
KEPT = 100


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=10_000, help="inputs for each decoder")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="names of decoders, with commas between")
    parser.add_argument("--guided", action="store_true", help="by atheris; the corpus grows")
    parser.add_argument("--inside", default="", help=argparse.SUPPRESS)
    parser.add_argument("--folder", default="", help=argparse.SUPPRESS)
    parser.add_argument("--again", default="", help="decode one file: tests/decoders/found/NAME-...")
    parser.add_argument("--keep", action="store_true", help="with --again: keep it in the corpus")
    options = parser.parse_args()
    if options.again:
        again(Path(options.again), kept=options.keep)
        return 0
    if options.folder:
        guided(options.inside, options.count, options.seed, options.folder)
    if options.inside:
        return fuzz(options.inside, options.count, options.seed)
    return all_of_them(options)


def all_of_them(options: argparse.Namespace) -> int:
    """Fuzz every decoder in sequence, and print the total."""
    from decoder_targets import TARGETS

    names = options.only.split(",") if options.only else list(TARGETS)
    broken, started, total = [], time.monotonic(), 0
    for name in names:
        count = max(1, options.count // TARGETS[name].share)
        arguments = ["--inside", name, "--count", str(count), "--seed", str(options.seed)]
        total += count
        if options.guided:
            crashed = hunt(name, arguments)
        else:
            crashed = subprocess.run([sys.executable, __file__, *arguments]).returncode
        if crashed:
            broken.append(name)
    elapsed = time.monotonic() - started
    crashes = f"crashes in {', '.join(broken)}" if broken else "0 crashes"
    summary = f"{len(names)} decoders, {total:,} inputs, seed {options.seed}"
    print(f"{summary}: {crashes} ({elapsed:.0f} s)")
    return 1 if broken else 0


def fuzz(name: str, count: int, seed: int) -> int:
    """Run mutations of the known inputs of one decoder; returns 1 after a crash."""
    from decoder_mutations import mutated
    from decoder_target import bounded
    from decoder_targets import TARGETS

    target, rng = TARGETS[name], random.Random(f"{name} {seed}")
    known = [*target.good, *corpus_of(name)]
    for data in known:
        target.decode(data)
    limit_memory()
    crashes: set[str] = set()
    started, slowest = time.process_time(), 0.0
    done = 0
    while done < count:
        done += 1
        data = mutated(target, rng.choice(known), rng, rng.choice(known))
        before = time.process_time()
        try:
            with bounded():
                target.decode(data)
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            report_crash(name, data, error, crashes)
            if len(crashes) >= MOST:
                break
        slowest = max(slowest, time.process_time() - before)
    elapsed = time.process_time() - started
    summary = f"{len(crashes)} crashes  {elapsed:7.1f} s  slowest {slowest * 1e3:.0f} ms"
    print(f"{name:14} {done:9,} inputs  {summary}", flush=True)
    return 1 if crashes else 0


def report_crash(name: str, data: bytes, error: BaseException, crashes: set[str]) -> None:
    """Store the input of a new crash, and report its source line."""
    frames = traceback.extract_tb(error.__traceback__)
    where = next((f for f in reversed(frames) if str(HERE) not in f.filename), frames[-1])
    kind = f"{type(error).__name__} {where.filename}:{where.lineno}"
    if kind in crashes:
        return
    crashes.add(kind)
    FOUND.mkdir(exist_ok=True)
    path = FOUND / f"{name}-{hashlib.sha256(data).hexdigest()[:12]}"
    path.write_bytes(data)
    print(f"CRASH {name}: {kind}: {error}\n    python tests/decoders/run.py --again {path}", flush=True)


def again(path: Path, *, kept: bool) -> None:
    """Decode the input of a file, with a traceback of its failure."""
    from decoder_target import bounded
    from decoder_targets import TARGETS

    name, data = path.name.rpartition("-")[0], path.read_bytes()
    if kept:
        keep(name, [*corpus_of(name), data])
    with bounded():
        TARGETS[name].decode(data)
    print("it is refused, or taken, as it should be")


def limit_memory() -> None:
    """Limit the address space: excessive allocations of an input fail."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_LIMIT, resource.getrlimit(resource.RLIMIT_AS)[1]))


def hunt(name: str, options: list[str]) -> int:
    """Fuzz with atheris; the shortest inputs with new coverage are stored."""
    from decoder_targets import TARGETS

    good = set(TARGETS[name].good)
    FOUND.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f"lfield-{name}-") as folder:
        for data in {*good, *corpus_of(name)}:
            (Path(folder) / hashlib.sha256(data).hexdigest()).write_bytes(data)
        before = set(FOUND.glob(f"{name}-*"))
        subprocess.run([sys.executable, __file__, *options, "--guided", "--folder", folder], check=True)
        old = corpus_of(name)
        reached = {path.read_bytes() for path in Path(folder).iterdir()} - good - set(old)
    # Existing inputs stay, including those that once crashed the decoder (--keep).
    keep(name, [*old, *sorted(reached, key=len)[: max(0, KEPT - len(old))]])
    return 1 if set(FOUND.glob(f"{name}-*")) - before else 0


def guided(name: str, count: int, seed: int, folder: str) -> None:
    """Run atheris in a process that libFuzzer ends; it adds inputs with new coverage to the folder."""
    import atheris

    with atheris.instrument_imports(include=["lfield", "lfield_mavlink", "lfield_can", "lfield_dynamixel"]):
        from decoder_mutations import mutated
        from decoder_target import bounded
        from decoder_targets import TARGETS

    target, crashes = TARGETS[name], set[str]()
    good = [*target.good, *corpus_of(name)]

    def take(data: bytes) -> None:
        try:
            with bounded():
                target.decode(data)
        except BaseException as error:
            report_crash(name, data, error, crashes)

    def mutate(data: bytes, most: int, number: int) -> bytes:
        rng = random.Random(number)
        return mutated(target, data, rng, rng.choice(good))[:most]

    flags = [
        f"-runs={count}",
        f"-seed={seed}",
        "-max_len=8192",
        "-rss_limit_mb=2000",
        "-verbosity=0",
        "-print_final_stats=1",
    ]
    atheris.Setup(
        [__file__, folder, f"-artifact_prefix={FOUND}/{name}-", *flags], take, custom_mutator=mutate
    )
    atheris.Fuzz()


if __name__ == "__main__":
    sys.exit(main())
