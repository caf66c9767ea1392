"""All tables and figures anew, from experiments/data alone. Trains nothing."""

import importlib

import pages
import study

STUDIES = ("returns", "last_std", "published", "settings", "race", "speed", "processes",
           "baselines", "robustness", "ablation", "exercises", "more_seeds")


def tables():
    """{name: table} of all studies; their figures are drawn."""
    found = {}
    for name in STUDIES:
        found |= importlib.import_module(name).draw(study.read(name))
    return found


if __name__ == "__main__":
    pages.write_tables(tables())
