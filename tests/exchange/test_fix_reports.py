"""A receiver may tell how good each fix is by a class, dilution of precision or C/N0 in place of an sd."""

import numpy as np
import pytest

from bench.core.words.exceptions import ConfigError
from bench.io.config.log import load_log
from bench.io.logs.log_records import read_records
from bench.pipeline.log_pipeline import read_log
from tests.exchange import drives

SD = ("sd_n_m", "sd_e_m", "sd_d_m")


def write(folder, columns, keys=""):
    """A log of the drive whose receiver reports other columns than standard deviations."""
    path = drives.write_log(folder)
    made = drives.gnss_columns(drives.sensed()["gnss"])
    kept = {name: column for name, column in made.items() if not name.startswith("sd_") and name != "quality"}
    drives.write_csv(folder / "gnss.csv", kept | columns(len(next(iter(kept.values())))))
    path.write_text(path.read_text().replace("[gnss]", f"[gnss]\n{keys}"))
    return path


def every_third(n, value, other):
    return np.where(np.arange(n) % 3 == 0, value, other)


@pytest.mark.parametrize(
    ("columns", "keys", "by", "horizontal", "vertical"),
    [
        (lambda n: {}, "", "", 1.0, 1.0),
        (lambda n: {"hdop": every_third(n, 2.4, 0.8)}, "", "dilution of precision", 3.0, 3.0),
        (
            lambda n: {"hdop": every_third(n, 2.4, 0.8), "vdop": every_third(n, 2.0, 1.0)},
            "", "dilution of precision", 3.0, 2.0,
        ),
        (lambda n: {"cn0_dbhz": every_third(n, 22.0, 42.0)}, "", "C/N0", 10.0, 10.0),
        (
            lambda n: {"quality": every_third(n, 5, 1)},
            "quality_sd_m = { 5 = 3.0 }", "quality class", 3.0 / drives.POS_SD[0], 3.0 / drives.POS_SD[2],
        ),
        (lambda n: {"quality": every_third(n, 5, 1)}, "", "", 1.0, 1.0),
    ],
)  # fmt: skip
def test_each_kind_of_report_weighs_the_fixes(tmp_path, columns, keys, by, horizontal, vertical):
    path = write(tmp_path, columns, keys)
    records = read_records(load_log(str(path)))
    assert records.reported == by
    sd = np.sqrt(np.einsum("mii->mi", records.fixes.cov_pos_n))
    np.testing.assert_allclose(sd[1::3], np.tile(drives.POS_SD, (len(sd[1::3]), 1)))
    worse = drives.POS_SD * [horizontal, horizontal, vertical]
    np.testing.assert_allclose(sd[::3], np.tile(worse, (len(sd[::3]), 1)))
    said = [check.text for check in read_log(path).checks if check.name == "fix_accuracy_m"]
    assert [f"weighted by the {by} it came with" in text for text in said] == ([True] if by else [])


def test_a_class_that_is_no_number_is_refused(tmp_path):
    path = write(tmp_path, lambda n: {"quality": np.ones(n)}, "quality_sd_m = { fix = 0.02 }")
    with pytest.raises(ConfigError, match="quality_sd_m: 'fix' must be a class of quality"):
        load_log(str(path))


@pytest.mark.parametrize("nothing", [0.0, -1.0, np.nan])
def test_a_standard_deviation_that_says_nothing_is_that_of_the_datasheet(tmp_path, nothing):
    """Of every third fix, along one axis of it alone, or of none at all."""
    path = write(tmp_path, lambda n: {name: every_third(n, nothing, 0.5) for name in SD})
    records = read_records(load_log(str(path)))
    sd = np.sqrt(np.einsum("mii->mi", records.fixes.cov_pos_n))
    np.testing.assert_allclose(sd[::3], np.tile(drives.POS_SD, (len(sd[::3]), 1)))
    np.testing.assert_allclose(sd[1::3], 0.5)
    assert [f"250 of {len(sd)} fixes lack a standard deviation of position" in n for n in records.notes] == [
        True
    ]
    path = write(tmp_path, lambda n: {name: np.full(n, 0.5 if name == SD[0] else nothing) for name in SD})
    sd = np.sqrt(np.einsum("mii->mi", read_records(load_log(str(path))).fixes.cov_pos_n))
    np.testing.assert_allclose(sd, np.tile([0.5, *drives.POS_SD[1:]], (len(sd), 1)))
    path = write(tmp_path, lambda n: {name: np.full(n, nothing) for name in SD})
    records = read_records(load_log(str(path)))
    sd = np.sqrt(np.einsum("mii->mi", records.fixes.cov_pos_n))
    np.testing.assert_allclose(sd, np.tile(drives.POS_SD, (len(sd), 1)))
    assert records.reported == ""
    assert ["no fix has a standard deviation of position above 0" in note for note in records.notes] == [True]


def test_a_covariance_that_says_nothing_is_that_of_the_datasheet(tmp_path):
    names = [f"cov_pos_{a}_pos_{b}" for a in "ned" for b in "ned"]
    given = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]]).reshape(-1)
    columns = dict(zip(names, given, strict=True))
    path = write(tmp_path, lambda n: {name: every_third(n, np.nan, columns[name]) for name in names})
    records = read_records(load_log(str(path)))
    np.testing.assert_allclose(records.fixes.cov_pos_n[1], given.reshape(3, 3))
    np.testing.assert_allclose(records.fixes.cov_pos_n[0], np.diag(drives.POS_SD**2))


def test_a_receiver_without_a_fix_writes_zeros(tmp_path):
    """Such rows are not used, nor of a reference, and a line says how many."""
    path = drives.write_log(tmp_path)
    made = drives.gnss_columns(drives.sensed()["gnss"])
    place = {name: every_third(len(made["t_s"]), 0.0, made[name]) for name in ("lat_deg", "lon_deg", "alt_m")}
    drives.write_csv(tmp_path / "gnss.csv", made | place)
    log = read_log(path)
    assert not log.records.fixes.valid[::3].any()
    assert log.records.fixes.valid[1::3].all()
    wrong = [check.text for check in log.checks if check.name == "gnss_invalid_rows"]
    assert ["250 rows are flagged, lie at latitude 0, longitude 0" in text for text in wrong] == [True]
    (tmp_path / "ref.csv").write_bytes((tmp_path / "gnss.csv").read_bytes())
    path.write_text(path.read_text() + '[reference]\nfile = "ref.csv"\n')
    judge_by = read_log(path).reference
    assert len(judge_by.track) == 500
