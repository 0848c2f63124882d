"""Results folders (Parquet and JSON), their provenance, and the cache of flown truth."""

from __future__ import annotations

from bench.store.arrow import to_arrow, to_pandas
from bench.store.cache_size import LIMIT, measure_cache, trim_cache
from bench.store.damage import RESULT, TRUTH, read_summary, report_damage
from bench.store.folders import (
    CAMPAIGN,
    EXPORT,
    add_to_mark,
    check_file,
    check_folder,
    keep_folder,
    make_folder,
    write_text,
)
from bench.store.parquet import read_table, write_table
from bench.store.provenance import hash_spec, list_versions, provenance
from bench.store.results import (
    CAMPAIGN_RESULT,
    RECORDING,
    REPORT,
    add_solution,
    copy_results,
    list_solutions,
    load,
    load_observations,
    load_output_times,
    load_sensors,
    load_solution,
    load_truth,
    save,
    to_json,
    write_json,
)
from bench.store.start import START, load_start, make_start_document, read_assumed_specs, read_initial_state
from bench.store.truth_cache import (
    cached_summary,
    cached_truth,
    join_pieces,
    read_truth,
    truth_key,
    truth_pieces,
    write_truth,
)

__all__ = [
    "CAMPAIGN",
    "CAMPAIGN_RESULT",
    "EXPORT",
    "LIMIT",
    "RECORDING",
    "REPORT",
    "RESULT",
    "START",
    "TRUTH",
    "add_solution",
    "add_to_mark",
    "cached_summary",
    "cached_truth",
    "check_file",
    "check_folder",
    "copy_results",
    "hash_spec",
    "join_pieces",
    "keep_folder",
    "list_solutions",
    "list_versions",
    "load",
    "load_observations",
    "load_output_times",
    "load_sensors",
    "load_solution",
    "load_start",
    "load_truth",
    "make_folder",
    "make_start_document",
    "measure_cache",
    "provenance",
    "read_assumed_specs",
    "read_initial_state",
    "read_summary",
    "read_table",
    "read_truth",
    "report_damage",
    "save",
    "to_arrow",
    "to_json",
    "to_pandas",
    "trim_cache",
    "truth_key",
    "truth_pieces",
    "write_json",
    "write_table",
    "write_text",
    "write_truth",
]
