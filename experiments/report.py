"""All tables and figures anew, from experiments/data alone. Trains nothing."""

import importlib

import pages
import study

STUDIES = ("returns", "last_std", "published", "settings", "race", "speed", "processes",
           "baselines", "robustness", "ablation", "exercises", "walker")


def commits():
    """Of a table: by which commits the rows of each study were measured."""
    for name in STUDIES:
        jobs = study.read(name).reindex(columns=[*study.KEYS, "commit"]).drop_duplicates()
        for script, of_script in jobs.groupby("script"):
            counts = of_script["commit"].value_counts()
            yield [f"`{name}.csv`", f"`{script}`",
                   ", ".join(f"{commit} ({count} jobs)" for commit, count in counts.items())]


def tables():
    """{name: table} of all studies; their figures are drawn."""
    found = {"commits": pages.table(["rows", "script", "commits"], commits())}
    for name in STUDIES:
        found |= importlib.import_module(name).draw(study.read(name))
    return found


if __name__ == "__main__":
    pages.write_tables(tables())
