"""What lies on disk: results folders (Parquet, JSON), their provenance, and the truth cache."""

from __future__ import annotations

from bench.store.provenance import provenance, spec_hash
from bench.store.results import (
    RESULT,
    load,
    load_observations,
    load_sensors,
    load_truth,
    results_folder,
    save,
    to_json,
    write_json,
)
from bench.store.truth_cache import truth_cached, truth_key, truth_pieces, truth_said

__all__ = [
    "RESULT",
    "load",
    "load_observations",
    "load_sensors",
    "load_truth",
    "provenance",
    "results_folder",
    "save",
    "spec_hash",
    "to_json",
    "truth_cached",
    "truth_key",
    "truth_pieces",
    "truth_said",
    "write_json",
]
