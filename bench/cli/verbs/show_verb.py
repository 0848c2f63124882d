"""The verb show: the figures of finished results, as tables."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from bench.cli.verbs.flight_verbs import RUNS, describe_run, print_end, print_result
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import one_line
from bench.io import results


def show_results(folder: Path | None, *, console: Console) -> None:
    """Print the figures of a run, a log, a campaign or a study; None for the newest run below ``runs``.

    Raises
    ------
    ConfigError
        If the folder has no results.
    """
    folder = folder or _find_newest()
    if (folder / results.CAMPAIGN_RESULT).is_file():
        from bench.cli.verbs.campaign_verb import print_campaign
        from bench.experiments.campaigns.stored import read_campaign

        print_campaign(console, read_campaign(folder), table=True)
    elif (folder / results.STUDY_RESULT).is_file():
        from bench.cli.verbs.study_verb import print_study
        from bench.io.results.study_folder import read_study

        print_study(console, read_study(folder), table=True)
    else:
        result = results.read_result(folder)
        title = str(result.profile.get("title", folder.name))
        if "log" in result.more:
            console.print(f"{one_line(title)}\n{result.evaluation}\n")
            from bench.cli.verbs.record_verbs import print_log

            print_log(console, result, table=True)
        else:
            console.print(
                describe_run(result.name, result.profile, result.seed, result.run, result.evaluation)
            )
            print_result(console, result, table=True)
    print_end(console, folder)


def _find_newest() -> Path:
    found = [path.parent for path in RUNS.glob(f"*/{results.RESULT}")]
    if not found:
        raise ConfigError(f"no results below {RUNS}: bench run figure-eight makes some")
    return max(found, key=lambda one: (one / results.RESULT).stat().st_mtime)
