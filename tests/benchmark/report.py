"""All tables and figures anew, from docs/data alone: python tests/benchmark/report.py

Needs scipy. Trains nothing.
"""

import importlib

import study

STUDIES = "returns", "ablation", "race", "speed", "baselines", "robustness", "exercises"


def tables():
    """{name: table} of all studies; their figures are drawn."""
    found = {}
    for name in STUDIES:
        found.update(importlib.import_module(name).draw(study.read(name)))
    return found


if __name__ == "__main__":
    study.put(tables())
