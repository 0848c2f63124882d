"""The recording of the fixes of real files: what it holds is what was solved."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench.cli.command_line import main
from bench.core.words.exceptions import NothingToShowError
from bench.plugins.receiver.fixes_page import make_page
from bench.plugins.receiver.fixes_recording import write_fixes
from bench.views.recording import column
from tests.data import gnss_file

FILES = ("ESBC00DNK_2020177_GREC_1800s.rnx", "ESBC00DNK_2020177_GREC_MN.rnx")


@pytest.fixture(scope="module")
def solved():
    return bench.solve_rinex(*map(gnss_file, FILES))


def test_the_recording_holds_track_errors_residuals_and_c_n0(solved, tmp_path):
    write_fixes(tmp_path / "fixes.rrd", solved)
    error, good = solved.errors(), solved.fixes.valid
    t, track = column(tmp_path / "fixes.rrd", "/track/fix", "Points2D:positions")
    assert_allclose(t, (solved.observations.t - solved.observations.t[0])[good], atol=1e-6)
    assert_allclose(track, np.column_stack([error[good, 1], -error[good, 0]]), atol=1e-5)
    _, north = column(tmp_path / "fixes.rrd", "/fixes/north/fix", "Scalars:scalars")
    assert_allclose(north[:, 0], error[good, 0])
    _, bounds = column(tmp_path / "fixes.rrd", "/fixes/north/bounds", "Scalars:scalars")
    assert_allclose(bounds[:, 0], 3 * np.sqrt(solved.fixes.cov_pos_n[good, 0, 0]))
    seen, rows = solved.seen, solved.seen.system == 2
    sat = int(seen.sat[rows & solved.solution.used][0])
    rows &= (seen.sat == sat) & solved.solution.used
    _, residual = column(tmp_path / "fixes.rrd", f"/fixes/residuals/Galileo/E{sat:02d}", "Scalars:scalars")
    assert_allclose(residual[:, 0], solved.solution.residual[rows])
    _, strength = column(tmp_path / "fixes.rrd", f"/satellites/cn0/Galileo/E{sat:02d}", "Scalars:scalars")
    heard = (seen.system == 2) & (seen.sat == sat) & (solved.solution.los_n[:, 2] < 0)
    assert_allclose(strength[np.isfinite(strength)], seen.cn0[heard & np.isfinite(seen.cn0[:, 0]), 0])


def test_the_sky_of_a_receiver_has_the_directions_of_its_satellites(solved):
    """Of elevation and azimuth again the line of sight, above the horizon only; used are those of the fix."""
    sky = solved.view_sky(solved.observations.t)
    level = np.cos(sky.elevation)
    los_n = np.column_stack(
        [level * np.cos(sky.azimuth), level * np.sin(sky.azimuth), -np.sin(sky.elevation)]
    )
    above = solved.solution.los_n[:, 2] < 0
    assert_allclose(los_n, solved.solution.los_n[above], atol=1e-9)
    assert np.array_equal(
        np.bincount(np.searchsorted(np.unique(sky.t), sky.t[sky.used])), solved.fixes.satellites
    )


def test_without_a_fix_there_is_nothing_to_record(tmp_path, capsys):
    """The line comes before fixes and page are written; without a recording they are, and say why."""
    out, page, place = (tmp_path / name for name in ("fixes.csv", "fixes.html", "fixes.rrd"))
    arguments = ["fixes", *(str(gnss_file(name)) for name in FILES), "--mask-deg", "60", "--systems", "gps"]
    arguments += ["-o", str(out), "--report", str(page)]
    assert main([*arguments, "--recording", str(place)]) != 0
    assert "error: no epoch has a fix: there is nothing to record" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())
    assert main(arguments) == 1
    assert "no fix: too few satellites" in page.read_text()
    assert "no fix: too few satellites" in capsys.readouterr().out


def test_a_truth_of_a_part_of_the_fixes_draws_that_part(solved, tmp_path):
    """Of none: a page without a track, and no recording."""
    solved.write_csv(tmp_path / "all.csv")
    head, *rows = (tmp_path / "all.csv").read_text().splitlines()
    for name, some in (("part", rows[5:20]), ("none", [row.replace("2020", "2019", 1) for row in rows])):
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *some]))
    part, none = (
        bench.solve_rinex(*map(gnss_file, FILES), truth=str(tmp_path / f"{name}.csv"))
        for name in ("part", "none")
    )
    assert "the truth covers 15 of 48 fixes: the others are not evaluated" in part.notes
    write_fixes(tmp_path / "part.rrd", part)
    t, _ = column(tmp_path / "part.rrd", "/track/fix", "Points2D:positions")
    assert_allclose(t, 1800.0 * np.arange(5, 20))
    assert 'class="track"' in make_page(part)
    assert 'class="track"' not in make_page(none)
    with pytest.raises(NothingToShowError, match="the truth covers no epoch with a fix"):
        write_fixes(tmp_path / "none.rrd", none)


def test_a_recording_is_replaced_only_when_told(tmp_path, capsys):
    place = tmp_path / "fixes.rrd"
    arguments = ["fixes", *(str(gnss_file(name)) for name in FILES), "--recording", str(place)]
    assert main(arguments) == 0
    assert f"bench view {place}" in " ".join(capsys.readouterr().out.split())
    assert main(arguments) == 2
    assert "fixes.rrd" in capsys.readouterr().err
    assert main([*arguments[:-1], str(tmp_path / "fixes.txt")]) == 2
    assert "a recording is an .rrd file" in capsys.readouterr().err
