"""README and docs: commands and snippets run, options exist, links resolve."""

import re
import subprocess
import sys

import pytest
from conftest import SCRIPTS
from harness import ROOT, STRICT

DOCUMENTS = [path for pattern in ("*.md", "docs/*.md", "experiments/data/*.md")
             for path in sorted(ROOT.glob(pattern))]
TEXT = "\n".join(path.read_text(encoding="utf-8") for path in DOCUMENTS)
SNIPPETS = re.findall(r"^```python\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
CALLS = sorted(set(re.findall(r"python (\w+)\.py((?: --[a-z-]+ [\w.:/-]+)+)(?=[ `\n|])", TEXT)))


@pytest.mark.parametrize(("name", "options"), [x for x in CALLS if x[0] in SCRIPTS])
def test_every_call_of_a_script_trains(name, options, tmp_path, monkeypatch):
    (snippet,) = [x for x in SNIPPETS if "class Push" in x]
    more = "".join(x for x in SNIPPETS if "gym.register" in x and x != snippet)
    (tmp_path / "my_module.py").write_text(snippet + more, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    seed = re.findall("--seed (\\d+)", options) or ["1"]
    sizes = "--total-steps 64 --eval-episodes 1 --num-evals 1".split()
    module = SCRIPTS[name].module
    module.train(0, module.parse_args([*options.split(), *sizes, "--seed", *seed]), tmp_path)


def test_the_environment_of_your_own_is_checked_and_a_trained_agent_plays(tmp_path):
    (push,) = [x for x in SNIPPETS if "class Push" in x]
    (tmp_path / "my_module.py").write_text(push, encoding="utf-8")
    subprocess.run([sys.executable, *STRICT, tmp_path / "my_module.py"], check=True)
    (block,) = [x for x in SNIPPETS if "import ppo_continuous" in x]
    path, played = SCRIPTS["ppo_continuous"].train(tmp_path), {}
    exec(block.replace("runs/…/seed-1", str(path)), played)
    assert played["terminated"] or played["truncated"]


def test_every_option_in_the_text_exists():
    known = set("--help --suppress-common-lines --standalone --nproc-per-node --array --wrap --tb "
                "--with --with-requirements --quick --again --only --check".split())
    for script in SCRIPTS.values():
        known |= {f"--{name.replace('_', '-')}" for name in vars(script.args())}
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", TEXT)) <= known


def anchors(path):
    """Of its headings, as the sites that show Markdown make them."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", x.lower()).replace(" ", "-") for x in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_inside_the_repository_resolve(document):
    for link in re.findall(r"\]\(([^)\s]+)", document.read_text(encoding="utf-8")):
        file, _, anchor = link.partition("#")
        if "://" not in link:
            path = (document.parent / file).resolve() if file else document
            assert path.exists(), link
            assert not anchor or anchor in anchors(path), link
