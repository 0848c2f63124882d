"""Write MATLAB files of version 7.3 by h5py, as ``save -v7.3`` lays them out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


def write_hdf5(path: Path, variables: dict[str, Any]) -> None:
    """Write variables: arrays as MATLAB shows them, vectors as columns, texts, and structures by field."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            _write(file, name, value)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sat Jan  3 12:00:00 2026 HDF5 schema 1.00 ."
    with path.open("r+b") as raw:
        raw.write(head.ljust(124) + b"\x00\x02IM")


def _write(group: Any, name: str, value: Any) -> None:
    if isinstance(value, dict):
        inner = group.create_group(name)
        inner.attrs["MATLAB_class"] = np.bytes_("struct")
        for field, one in value.items():
            _write(inner, field, one)
        return
    if isinstance(value, str):
        item = group.create_dataset(name, data=np.frombuffer(value.encode("utf-16-le"), "<u2")[:, None])
        item.attrs["MATLAB_class"], item.attrs["MATLAB_int_decode"] = np.bytes_("char"), np.int32(2)
        return
    array = np.asarray(value)
    array = array.reshape(-1, 1) if array.ndim < 2 else array
    kind = {"f8": "double", "f4": "single", "b1": "logical"}.get(array.dtype.str[1:], array.dtype.name)
    stored = array.astype("u1") if kind == "logical" else array
    if array.size:
        packed = {"compression": "gzip", "chunks": True} if array.size > 100 else {}
        item = group.create_dataset(name, data=np.ascontiguousarray(stored.T), **packed)
    else:
        item = group.create_dataset(name, data=np.array(array.shape, "<u8"))
        item.attrs["MATLAB_empty"] = np.uint8(1)
    item.attrs["MATLAB_class"] = np.bytes_(kind)
