"""What lies on disk: results folders (Parquet, JSON), their provenance, and the truth cache."""

from __future__ import annotations

from bench.store.arrow import to_arrow, to_pandas
from bench.store.folders import check_folder, new_folder
from bench.store.provenance import provenance, spec_hash
from bench.store.results import (
    RECORDING,
    RESULT,
    TRUTH,
    add_solution,
    load,
    load_observations,
    load_sensed,
    load_sensors,
    load_solution,
    load_truth,
    results_folder,
    save,
    solutions_of,
    to_json,
    write_json,
)
from bench.store.start import START, assumed_specs, initial_state, load_start, start_document
from bench.store.truth_cache import join_pieces, truth_cached, truth_key, truth_pieces, truth_said

__all__ = [
    "RECORDING",
    "RESULT",
    "START",
    "TRUTH",
    "add_solution",
    "assumed_specs",
    "check_folder",
    "initial_state",
    "join_pieces",
    "load",
    "load_observations",
    "load_sensed",
    "load_sensors",
    "load_solution",
    "load_start",
    "load_truth",
    "new_folder",
    "provenance",
    "results_folder",
    "save",
    "solutions_of",
    "spec_hash",
    "start_document",
    "to_arrow",
    "to_json",
    "to_pandas",
    "truth_cached",
    "truth_key",
    "truth_pieces",
    "truth_said",
    "write_json",
]
