"""Small cuts of real recordings; the README of each folder names source and licence."""

import gzip
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).parent


@cache
def _unpacked() -> TemporaryDirectory:
    return TemporaryDirectory(prefix="bench-tests-")  # removed when the process ends


@cache
def gnss_file(name: str) -> Path:
    """Return the path of a RINEX or YUMA file, unpacked."""
    path = Path(_unpacked().name) / name
    path.write_bytes(gzip.decompress((HERE / "gnss" / f"{name}.gz").read_bytes()))
    return path


def stored_gnss_file(name: str) -> Path:
    """Return the path of a file as it lies in the repository, packed or not."""
    return HERE / "gnss" / name
