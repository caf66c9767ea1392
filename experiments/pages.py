"""Tables and figures in the pages: a table replaces the one that stands below `<!-- NAME -->`."""

import re

import pandas as pd
import seaborn as sns
from matplotlib.figure import Figure
from variants import ROOT


def table(header, lines):
    """Markdown."""
    frame = pd.DataFrame([list(line) for line in lines], columns=[str(name) for name in header])
    return frame.to_markdown(index=False, disable_numparse=True) + "\n"


def files():
    return [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("experiments/data/*.md")]


def write_tables(tables):
    """Into the pages."""
    for page in files():
        parts = re.split(r"(?<=<!-- )(.+)( -->\n\n)((?:\|.*\n)*)", page.read_text("utf-8"))
        for i in range(1, len(parts), 4):
            parts[i + 2] = tables.get(parts[i], parts[i + 2])
        page.write_text("".join(parts), encoding="utf-8")


def figure(width, height, rows=1, columns=1, **options):
    """A picture and its panels."""
    sns.set_theme("talk", "whitegrid", "colorblind", font_scale=0.85)
    picture = Figure(figsize=(width, height), layout="constrained")
    return picture, picture.subplots(rows, columns, squeeze=False, **options).ravel()


def curves(rows, x, axis, y="return", label=None, color="C0", **labels):
    """Every seed, and the mean in bold."""
    sns.lineplot(rows, x=x, y=y, units="seed", estimator=None, alpha=0.5, lw=1, color=color,
                 ax=axis)
    sns.lineplot(rows, x=x, y=y, errorbar=None, linewidth=3, label=label, color=color, ax=axis)
    axis.set(**{"xlabel": x.replace("_", " "), "ylabel": "return", **labels})


def save(picture, name):
    picture.savefig(ROOT / f"docs/{name}.png", dpi=120)
