"""The experiments behind every number of README and docs.

    python tests/benchmark run STUDY ...      what has not been measured yet, into docs/data
    python tests/benchmark report [--check]   all figures and tables, from docs/data
    python tests/benchmark merge FOLDER ...   one table and one figure of run folders from anywhere
"""

import argparse
import importlib
import sys
from pathlib import Path

STUDIES = ("returns", "ablation", "exercises", "baselines", "race", "robustness", "scaling",
           "speed", "processes", "gallery")
SHOWN = (*STUDIES, "trials")  # trials are not repeated: they are of earlier texts


def make_parser():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, prog="benchmark")
    commands = parser.add_subparsers(dest="command", required=True)
    add = commands.add_parser("run", help="measure what is missing").add_argument
    add("study", nargs="+", choices=STUDIES)
    add("--quick", action="store_true", help="a tiny trial, not into docs/data")
    add("--out-dir", type=Path, help="default: docs/data, with --quick runs/quick")
    add = commands.add_parser("report", help="make figures and tables").add_argument
    add("--check", action="store_true", help="write nothing; name what is not up to date")
    add = commands.add_parser("merge", help="show runs from anywhere").add_argument
    add("folders", nargs="+", type=Path, metavar="FOLDER")
    add("--out-dir", type=Path, default="runs/merged", help="for the table and the figure")
    return parser


def main(argv=None):
    args = make_parser().parse_args(argv)
    module = {"run": "common", "report": "reports", "merge": "merge"}[args.command]
    module = importlib.import_module(f"benchmark.{module}")
    if args.command == "run":
        home = module.ROOT / "runs/quick" if args.quick else module.DATA
        for name in args.study:
            module.run(name, args.quick, args.out_dir or home)
    elif args.command == "merge":
        module.merge(args.folders, args.out_dir)
    elif not args.check:
        module.report(SHOWN)
    elif found := module.stale(SHOWN):
        sys.exit("\n".join(["not up to date:", *found]))


if __name__ == "__main__":
    here = Path(__file__).resolve()
    sys.path[:1] = [str(here.parents[1]), str(here.parents[2])]  # of benchmark, of the scripts
    main()
