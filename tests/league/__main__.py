"""``python -m tests.league``: run the league, print its tables, write its page and its file."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from tests.league.league import make_league, verify_league
from tests.league.league_page import PAGE, write_page, write_tables


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.league", description=__doc__)
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="these filters alone")
    parser.add_argument("--seed", type=int, help="other noise, places, winds and times of outages")
    parser.add_argument("--runs", type=int, help="runs of each flight")
    parser.add_argument("--no-audit", action="store_true", help="leave out the proof of causality")
    parser.add_argument("-o", "--out", type=Path, help="write the league to a JSON file")
    parser.add_argument("--page", action="store_true", help=f"write the tables to {PAGE.name}")
    parser.add_argument("--show", type=Path, metavar="JSON", help="print the tables of a file; run nothing")
    parser.add_argument("--sort", default="", metavar="COLUMN", help="sort by a column: part of its head")
    parser.add_argument("--verify", type=Path, metavar="JSON", help="repeat three random runs of a file")
    given = parser.parse_args(arguments)
    if given.verify:
        repeated, found = verify_league(json.loads(given.verify.read_text(encoding="utf-8")))
        print("\n".join(f"repeated {one}" for one in repeated))
        print("\n".join(found) or "equal to the bit")
        return 1 if found else 0
    if given.show:
        print(write_tables(json.loads(given.show.read_text(encoding="utf-8")), given.sort))
        return 0
    league = make_league(given.only, given.seed, given.runs, not given.no_audit)
    print(write_tables(league, given.sort))
    if given.out:
        given.out.write_text(json.dumps(league, indent=1) + "\n", encoding="utf-8")
    if given.page:
        write_page(league)
    return 0


if __name__ == "__main__":
    sys.exit(main())
