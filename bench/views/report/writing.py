"""Write pages and figures of results folders."""

from __future__ import annotations

from pathlib import Path

from bench.core.files import durable
from bench.core.words.exceptions import ConfigError
from bench.core.words.stages import Progress, Stage, ignore
from bench.experiments.campaigns.stored import read_campaign
from bench.io import results
from bench.io.results.study_folder import read_study
from bench.views.report import campaign_page, index, page, paper, study_page


def write_report(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    force: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write the HTML report of a results folder, a campaign or a study, or the index of several results.

    Parameters
    ----------
    folder : str or Path
        Folder of results, of a campaign or a study, or a folder with results folders, two levels deep.
    out : str or Path, optional
        File to write. Default: ``report.html`` in the folder. For a folder of results ``index.html``, and a
        report in each results folder that has none.
    force : bool, optional
        Replace ``out``.
    progress : callable, optional
        Called with a `Stage` for each results folder that cannot be read.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    bench.ConfigError
        If there are no results, or the file exists and bench did not write it or ``force`` is missing.
    OSError
        If a file cannot be written; an existing file is left unchanged.

    Examples
    --------
    >>> import bench, tempfile
    >>> result = bench.run("approach", estimators=["loose-15"], causes=False)
    >>> with tempfile.TemporaryDirectory() as place:
    ...     folder = bench.write_result(result, place + "/a", recording=False, report=False)
    ...     bench.write_report(folder).name
    'report.html'
    """
    folder = Path(folder)
    of_campaign = (folder / results.CAMPAIGN_RESULT).is_file()
    of_study = (folder / results.STUDY_RESULT).is_file()
    single = of_campaign or of_study or (folder / results.RESULT).is_file()
    folders = [] if single else index.find_folders(folder)
    path = Path(out) if out is not None else folder / (index.INDEX if folders else results.REPORT)
    page.check_page(path, force=force or out is None)
    if not folders:
        name = folder.resolve().name
        if of_campaign:
            text = campaign_page.make_page(name, read_campaign(folder))
        elif of_study:
            text = study_page.make_page(read_study(folder), page.read_day(folder / results.STUDY_RESULT))
        else:
            text = page.make_page(name, results.read_result(folder))
        durable.write(path, text)
        if out is None:
            results.add_to_mark(folder, results.REPORT)
        return path
    for one in folders:
        if not (one / results.REPORT).exists():
            try:
                write_report(one)
            except ConfigError as error:
                (progress or ignore)(Stage(str(error)))
    index.write_index(path, folders)
    return path


def write_figures(
    folder: str | Path,
    out: str | Path,
    form: str = "pdf",
    *,
    width_mm: float = 88.0,
    serif: bool = False,
    force: bool = False,
) -> list[Path]:
    """Draw the figures of a results folder for a paper, one file for each tab and filter, or of a study.

    Parameters
    ----------
    folder : str or Path
        A results folder, or that of a study.
    out : str or Path
        The folder for the files.
    form : {"pdf", "svg", "png"}
        Their format.
    width_mm : float
        Their width [mm].
    serif : bool
        Letters with serifs.
    force : bool
        Replace the figures in ``out``.

    Returns
    -------
    written : list of Path
        The files, such as ``loose-15-position.pdf``.
    """
    if form not in paper.FORMATS:
        raise ConfigError(f"form = {form!r} must be one of {', '.join(paper.FORMATS)}")
    out = Path(out)
    study = read_study(folder) if (Path(folder) / results.STUDY_RESULT).is_file() else None
    result = results.read_result(folder) if study is None else None
    results.check_folder(out, force=force, kind=results.FIGURES)
    with results.make_folder(out, force=force, kind=results.FIGURES) as partial:
        if study is not None:
            drawings = {name: [plot] for name, plot in study.figures.items()}
            written = paper.write_drawings(partial, drawings, (), form, width_mm=width_mm, serif=serif)
        elif result is not None:
            written = paper.write_figures(partial, result, form, width_mm=width_mm, serif=serif)
    return [out / path.name for path in written]
