"""Every reader of calibrations against mutated files: whatever is not refused by one sentence is a fault.

Valid files of all formats (stereo and, where there is one, single camera) are mutated: bytes changed, removed, doubled
or swapped, numbers replaced by the extremes (NaN, 1e999, −0, negative sizes, a thousand digits), entries removed or
repeated, types changed, the rest cut off, pieces of other formats put in. Each is read by its own reader and by
whichever the content asks for. A reader may refuse by ``DataFileError`` or ``InputError``, or read: what it reads must
then be finite. Anything else (another exception, a warning, more than two seconds of processor time) is printed with
the seed that makes it again.

    python benchmarks/study_hostile_files.py --seconds 120 --seed 0
"""

from __future__ import annotations

import argparse
import re
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from random import Random

import numpy as np

from stereocal.base.errors import DataFileError, InputError
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.store.calibrations import FORMATS, load_record, save_calibration
from stereocal.store.rectified_pairs import rectified_rig

LENS = [-0.3, 0.1, 1e-3, -2e-5, 0.0]
CAMERA = Camera([[500.0, 0, 320], [0, 501, 240], [0, 0, 1]], LENS, (640, 480))
RIG = StereoRig(CAMERA, CAMERA, np.eye(3), [-60.0, 0.1, 0.2])
SMALL = StereoRig(*(Camera([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]], LENS, (64, 48)),) * 2, np.eye(3), [-60.0, 0.1, 0.2])
RECTIFIED = rectified_rig((500.0, 500.0), (320.0, 330.0), 240.0, 60.0, (640, 480))

NUMBERS = (
    "NaN", "nan", ".nan", ".inf", "Infinity", "-inf", "1e999", "-1e999", "1e308", "-1e308", "1e-320", "0", "-0",
    "-1", "0.5", "1e5", "1e18", "99999999999999999999", "-640", "1e3", "true", "null", "~", "[]", "{}", "''",
    "\"\"", "1_0", "0x10", "1:30", "[[1]]", "2001-01-01", "3+4j", "b'1'", "()", "9" * 5000, "1e" + "9" * 400, "[" *
    300, "!!float 1", "&a 1", "*a", "<<", "\u0661", "1\u00a0",
)  # fmt: skip
BYTES = b"0123456789.-+eE[]{}():,;=\"'\n\r\t !&*%#@|><?\x00\x01\x7f\x80\xff\xfe_~/\\"
ANY_NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")


def samples(folder: Path) -> dict[str, list[tuple[Path, list[Path]]]]:
    """Return, for each format, what to load and the files it is made of."""
    found: dict[str, list[tuple[Path, list[Path]]]] = {name: [] for name in FORMATS}
    endings = {"opencv": (".yml", ".xml", ".json"), "matlab": (".mat", ".json")}
    for name in FORMATS:
        stereo = RECTIFIED if name in ("kitti", "middlebury") else SMALL if name == "paper" else RIG
        for each, label in ((stereo, "stereo"), (CAMERA, "camera")):
            for ending in endings.get(name, ("",)):
                path = folder / f"{name}_{label}{ending}"
                try:
                    files = save_calibration(each, path, format=name, unit="mm")
                except InputError:
                    continue  # the format has no such file
                found[name].append((path, files))
    return found


def mutate(content: bytes, random: Random, others: list[bytes]) -> bytes:
    """Return the content after one to four accidents."""
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        content = random.choice(ACCIDENTS)(content, random, others)
    return content


def change_bytes(content: bytes, random: Random, others: list[bytes]) -> bytes:
    """Overwrite a few bytes."""
    changed = bytearray(content)
    for _ in range(random.choice((1, 2, 8, 40)) if changed else 0):
        changed[random.randrange(len(changed))] = random.choice((random.choice(BYTES), random.randrange(256)))
    return bytes(changed)


def replace_number(content: bytes, random: Random, others: list[bytes]) -> bytes:
    """Put an extreme in a number's place."""
    places = [match.span() for match in ANY_NUMBER.finditer(content[:100_000])]
    if not places:
        return content
    start, end = random.choice(places)
    return content[:start] + random.choice(NUMBERS).encode() + content[end:]


def cut(content: bytes, random: Random, others: list[bytes]) -> bytes:
    """Cut the end off, or a piece out."""
    start, end = sorted(random.randrange(len(content) + 1) for _ in range(2))
    return random.choice((content[:start], content[:start] + content[end:], content[start:]))


def change_lines(content: bytes, random: Random, others: list[bytes]) -> bytes:
    """Remove, repeat, swap or indent a line."""
    lines = content.split(b"\n")
    k, m = random.randrange(len(lines)), random.randrange(len(lines))
    kind = random.randrange(5)
    if kind == 0:
        del lines[k]
    elif kind == 1:
        lines.insert(m, lines[k])
    elif kind == 2:
        lines[k], lines[m] = lines[m], lines[k]
    elif kind == 3:
        lines[k] = b"  " + lines[k]
    else:
        lines[k] = lines[k].split(b":")[0] + b": " + random.choice(NUMBERS).encode()
    return b"\n".join(lines)


def graft(content: bytes, random: Random, others: list[bytes]) -> bytes:
    """Put a piece of another format in."""
    other = random.choice(others)
    start, end = sorted(random.randrange(len(other) + 1) for _ in range(2))
    place = random.randrange(len(content) + 1)
    return content[:place] + other[start : min(end, start + 2000)] + content[place:]


def change_words(content: bytes, random: Random, others: list[bytes]) -> bytes:
    """Swap two words, brackets and all."""
    words = re.split(rb"([^\w.+-]+)", content[:100_000])
    k, m = random.randrange(len(words)), random.randrange(len(words))
    words[k], words[m] = words[m], words[k]
    return b"".join(words) + content[100_000:]


def whole_words(content: bytes, random: Random, others: list[bytes]) -> bytes:
    """Replace any word by an extreme."""
    words = re.split(rb"([^\w.+-]+)", content[:100_000])
    words[random.randrange(len(words))] = random.choice(NUMBERS).encode()
    return b"".join(words) + content[100_000:]


ACCIDENTS = (change_bytes, replace_number, replace_number, cut, change_lines, graft, change_words, whole_words)


def check(path: Path, name: str | None) -> str:
    """Load and say what happened: "read", "refused", or the fault."""
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            record = load_record(path, format=name)
        outcome = "read"
        for camera in record.cameras:
            if not (np.isfinite(camera.K).all() and np.isfinite(camera.dist).all()):
                outcome = "FAULT: read numbers that are not finite"
        if record.is_stereo and not np.isfinite(np.append(record.calibration.R.ravel(), record.calibration.T)).all():
            outcome = "FAULT: read a pose that is not finite"
    except (DataFileError, InputError) as error:
        text = str(error)
        outcome = f"FAULT: no short sentence: {text!r:.300}" if "\n" in text or len(text) > 800 else "refused"
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        where = traceback.extract_tb(error.__traceback__)[-1]
        outcome = f"FAULT: {type(error).__name__}: {str(error)[:100]} ({Path(where.filename).name}:{where.lineno})"
    if time.process_time() - start > 2:
        outcome = f"FAULT: took {time.process_time() - start:.1f} s"
    return outcome


def main() -> None:
    """Fuzz for a while and print the count of outcomes and each fault once."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--format", choices=list(FORMATS))
    arguments = parser.parse_args()
    names = [arguments.format] if arguments.format else list(FORMATS)
    outcomes: Counter[tuple[str, str]] = Counter()
    faults: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as place:
        found = samples(Path(place))
        texts = {name: [f.read_bytes() for _, files in found[name] for f in files] for name in FORMATS}
        others = [text for all_of_one in texts.values() for text in all_of_one]
        end, seed = time.monotonic() + arguments.seconds, arguments.seed
        while time.monotonic() < end:
            random = Random(seed)
            name = names[seed % len(names)]
            path, files = random.choice(found[name])
            victim = random.choice(files)
            whole = victim.read_bytes()
            victim.write_bytes(mutate(whole, random, others))
            for forced in (name, None):
                outcome = check(path, forced)
                outcomes[name, outcome.split(":")[0]] += 1
                if outcome.startswith("FAULT"):
                    faults.setdefault(f"{name}: {outcome}", f"seed {seed}")
            victim.write_bytes(whole)
            seed += 1
    print(f"{seed - arguments.seed} mutated files, seeds {arguments.seed} to {seed - 1}")
    for name in names:
        counts = ", ".join(f"{kind} {count}" for (which, kind), count in sorted(outcomes.items()) if which == name)
        print(f"  {name:<11} {counts}")
    print(f"{len(faults)} kinds of faults")
    for fault, where in faults.items():
        print(f"  {fault} [{where}]")


if __name__ == "__main__":
    main()
