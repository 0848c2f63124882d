"""The public Python functions that list exports, studies and metrics."""

from __future__ import annotations

from bench.experiments.studies import find_studies
from bench.io.config.listing import CatalogEntry


def list_exports() -> list[CatalogEntry]:
    """Return the formats that `bench.export_run` writes."""
    from bench.io.exports import list_formats

    return [CatalogEntry(name, title, "export") for name, title in list_formats().items()]


def list_studies() -> list[CatalogEntry]:
    """Return the studies that `bench.study` runs.

    Returns
    -------
    list of CatalogEntry
        ``name`` and ``title``, the question that the study answers.

    Examples
    --------
    >>> import bench
    >>> [entry.name for entry in bench.list_studies()][:2]
    ['requirements', 'outages']
    """
    return [CatalogEntry(name, entry.question, "study") for name, entry in find_studies().items()]


def list_metrics() -> list[CatalogEntry]:
    """Return the metrics that `bench.evaluate` computes and that a requirement can name.

    Returns
    -------
    list of CatalogEntry
        ``name``, which ends in the unit, ``title`` and ``note``: which side is better. Names with ``{}``
        stand for several metrics.

    Examples
    --------
    >>> import bench
    >>> next(entry for entry in bench.list_metrics() if entry.name == "cep95_m").note
    'lower is better'
    """
    from bench.evaluation.metrics.run_metrics import METRICS

    return [
        CatalogEntry(one.name, one.words.rstrip("."), "metric", _BETTER[one.direction]) for one in METRICS
    ]


_BETTER = {
    "lower": "lower is better",
    "matched": "its expected value is best",
    "zero": "0 is best",
    "not evaluated": "bench check does not compare it",
}
"""Direction of a metric -> its meaning for a reader."""
