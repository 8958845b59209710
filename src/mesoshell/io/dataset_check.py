"""Every fault of a dataset folder: rows, images, and what is missing or left over (NumPy only)."""

from collections.abc import Iterator
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Any

from mesoshell.errors import InputError
from mesoshell.io.dataset import Sample, entries, read_manifest, sample_of
from mesoshell.io.dataset_images import image_faults


def check_dataset(folder: str | PathLike[str]) -> list[str]:
    """Every fault of a dataset, one line each: its text files, its images and what is missing or left over."""
    folder = Path(folder)
    try:
        manifest = read_manifest(folder)
        rows = list(entries(folder, manifest))
    except InputError as error:
        return [str(error)]
    faults = [str(entry) for entry in rows if isinstance(entry, InputError)]
    samples = [sample_of(folder, entry) for entry in rows if not isinstance(entry, InputError)]
    faults += [f"{folder / 'samples.jsonl'}: {fault}" for fault in _count_faults(manifest, samples)]
    faults += [fault for sample in samples for fault in image_faults(sample)]
    there = {path for name in ("images", "shards") for path in (folder / name).glob("*")}
    left_over = sorted(there - {sample.file for sample in samples})
    return faults + [f"{path}: has no row in samples.jsonl" for path in left_over]


def _count_faults(manifest: dict[str, Any], samples: list[Sample]) -> list[str]:
    """Samples missing, or too many. A packed dataset may be of a part of the samples, so that it has a number only."""
    count, there = manifest["count"], {sample.index for sample in samples}
    if "packed" in manifest:
        return [f"has {len(there)} of {count} samples"] if len(there) != count else []
    lists = (
        ("has no row for", (i for i in range(count) if i not in there), max(0, count) - sum(i < count for i in there)),
        (
            "has more than the manifest's count:",
            (i for i in sorted(there) if i >= count),
            sum(i >= count for i in there),
        ),
    )
    return [f"{what} {_some(indices, number)}" for what, indices, number in lists if number]


def _some(indices: Iterator[int], number: int) -> str:
    """The first of them, which rise, and how many more there are: a manifest may claim any number."""
    first = ", ".join(map(str, islice(indices, 8)))
    return f"sample{'s' * (number > 1)} {first}{f' and {number - 8} more' * (number > 8)}"
