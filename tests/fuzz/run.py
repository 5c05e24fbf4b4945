"""Feed inputs to a parser of bytes from outside, and keep each input that makes it raise.

Usage: ``python -m tests.fuzz.run NAME --inputs 1000000`` (names: ``--list``). With atheris (``pip install atheris``,
which is not among the locked tools) libFuzzer chooses the inputs by the branches that they reach; without it they are
mutations of the corpus by a seeded generator. An input that makes a parser raise is kept as ``crash-*`` in the folder
of ``--keep``, and ends the run with code 77 or 1.
"""

import argparse
import random
import sys
import tempfile
import time
from pathlib import Path

_LONGEST = 1024


def main() -> None:
    """Run one parser."""
    arguments = _arguments()
    if arguments.list:
        from tests.fuzz.parsers import PARSERS  # noqa: PLC0415 - instrumented further down

        print("\n".join(PARSERS))
        return
    try:
        import atheris  # noqa: PLC0415 - optional
    except ImportError:
        _mutate(arguments)
    else:
        _guided(atheris, arguments)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", nargs="?", help="which parser")
    parser.add_argument("--list", action="store_true", help="print the names of the parsers")
    parser.add_argument("--inputs", type=int, default=100_000, help="how many inputs")
    parser.add_argument("--seed", type=int, default=1, help="chooses the inputs: the same seed gives the same ones")
    parser.add_argument(
        "--keep", type=Path, default=Path(tempfile.gettempdir()), help="folder for inputs that make a parser raise"
    )
    found = parser.parse_args()
    if not (found.list or found.name):
        parser.error("name a parser; --list names them")
    return found


def _guided(atheris, arguments: argparse.Namespace) -> None:
    with atheris.instrument_imports(include=["daemon", "drivers", "tomllib", "json", "csv"]):
        from tests.fuzz.parsers import PARSERS, corpus  # noqa: PLC0415
    parser = PARSERS[arguments.name]
    grown = arguments.keep / f"corpus-{arguments.name}"
    grown.mkdir(parents=True, exist_ok=True)
    for number, data in enumerate(corpus(arguments.name)):
        (grown / f"kept-{number}").write_bytes(data)
    words = arguments.keep / f"words-{arguments.name}"
    quoted = ("".join(f"\\x{byte:02x}" for byte in word[:60]) for word in parser.words)
    words.write_text("\n".join(f'"{word}"' for word in quoted) + "\n")
    options = [
        f"-runs={arguments.inputs}",
        f"-seed={arguments.seed}",
        f"-max_len={_LONGEST}",
        f"-artifact_prefix={arguments.keep}/",
        f"-dict={words}",
        "-timeout=10",
        "-print_final_stats=1",
        "-verbosity=1",
    ]
    atheris.Setup([sys.argv[0], *options, str(grown)], parser.build())
    atheris.Fuzz()


def _mutate(arguments: argparse.Namespace) -> None:
    from tests.fuzz.parsers import PARSERS, corpus  # noqa: PLC0415

    parser, choice = PARSERS[arguments.name], random.Random(arguments.seed)
    take, kept, began_s = parser.build(), list(corpus(arguments.name)), time.process_time()
    for number in range(arguments.inputs):
        data = mutated(choice, kept, parser.words)
        try:
            take(data)
        except BaseException:
            path = arguments.keep / f"crash-{arguments.name}-{number}"
            path.write_bytes(data)
            print(f"{arguments.name}: input {number} of seed {arguments.seed} is kept as {path}", file=sys.stderr)
            raise
    print(f"{arguments.name}: {arguments.inputs} inputs, {time.process_time() - began_s:.0f} s of processor time")


def mutated(choice: random.Random, kept: list[bytes], words: tuple[bytes, ...]) -> bytes:
    """Return one of the kept inputs with a few changes, or now and then plain noise."""
    if choice.random() < 0.05:
        return choice.randbytes(choice.randrange(200))
    data = bytearray(choice.choice(kept))
    for _ in range(choice.choice((1, 1, 2, 3, 5))):
        place = choice.randrange(len(data) + 1)
        length = choice.choice((1, 1, 2, 4, 16))
        match choice.randrange(6):
            case 0:
                data[place : place + length] = choice.randbytes(length)
            case 1:
                del data[place : place + length]
            case 2:
                data[place:place] = choice.choice(words or (b"\0",))
            case 3:
                data[place:place] = data[place : place + length] * choice.choice((1, 2, 50))
            case 4:
                other = choice.choice(kept)
                data[place:] = other[choice.randrange(len(other) + 1) :]
            case _:
                if place < len(data):
                    data[place] ^= 1 << choice.randrange(8)
    return bytes(data[:_LONGEST])


if __name__ == "__main__":
    main()
