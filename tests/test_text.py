"""Text: functions that files share, requirements, and pages, whose commands run."""

import ast
import re
import subprocess
import sys

import pytest
from conftest import SCRIPTS
from harness import ROOT, STRICT

TEXTS = {name: (ROOT / f"{name}.py").read_text(encoding="utf-8") for name in SCRIPTS}
SAME = {"plot": 3, "bounded": 3, "evaluate": 2, "main": 2, "watch": 2, "rollout": 2,
        "compute_gae": 2, "RunningStatistics": 2, "mlp": 2}  # PPO shares it with one more, or both


def test_functions_of_the_same_name_have_the_same_text_in_these_files():
    found = [(node.name, ast.get_source_segment(text, node)) for text in TEXTS.values()
             for node in ast.parse(text).body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
    shared = {name: found.count((name, text)) for name, text in found}
    assert {name: count for name, count in shared.items() if count > 1} == SAME


def test_requirements_txt_is_what_the_scripts_ask_for():
    listed = set((ROOT / "requirements.txt").read_text().splitlines())
    for name, text in TEXTS.items():
        block = re.match(r"(?s)# /// script\n(.*?)\n# ///\n", text).group(1)
        extra = "box2d" if name == "a2c_vector" else "mujoco"
        packages = re.findall(r'"([^"]+)"[,\]]', block)
        assert any(x.startswith("mujoco") for x in packages) == (extra == "mujoco")
        assert {x.replace(f"[{extra}]", "[mujoco,box2d]") for x in packages} < listed


DOCUMENTS = [path for pattern in ("*.md", "docs/*.md", "experiments/data/*.md")
             for path in sorted(ROOT.glob(pattern))]
TEXT = "\n".join(path.read_text(encoding="utf-8") for path in DOCUMENTS)
SNIPPETS = re.findall(r"^```python\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
CALLS = sorted(set(re.findall(r"python (\w+)\.py((?: --[a-z-]+ [\w.:/-]+)+)(?=[ `\n|])", TEXT)))


@pytest.fixture
def my_module(tmp_path, monkeypatch):
    """The guide's environments, in a file of this name."""
    (push,) = [x for x in SNIPPETS if "class Push" in x]
    others = [x for x in SNIPPETS if "gym.register" in x and x != push]
    (tmp_path / "my_module.py").write_text("".join([push, *others]), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path / "my_module.py"


@pytest.mark.parametrize(("name", "options"), [x for x in CALLS if x[0] in SCRIPTS])
def test_every_call_of_a_script_trains(name, options, my_module, tmp_path):
    seed = re.findall("--seed (\\d+)", options) or ["1"]
    sizes = "--total-steps", "64", "--eval-episodes", "1", "--num-evals", "1", "--seed", *seed
    module = SCRIPTS[name].module
    module.train(0, module.parse_args([*options.split(), *sizes]), tmp_path)


def test_the_environment_of_your_own_is_checked_and_a_trained_agent_plays(my_module, tmp_path):
    subprocess.run([sys.executable, *STRICT, my_module], check=True)
    (block,) = [x for x in SNIPPETS if "import ppo_continuous" in x]
    path, played = SCRIPTS["ppo_continuous"].train(tmp_path), {}
    exec(block.replace("runs/…/seed-1", str(path)), played)
    assert played["terminated"] or played["truncated"]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_inside_the_repository_resolve(document):
    for link in re.findall(r"\]\((?!\w+://)([^)\s]+)", document.read_text(encoding="utf-8")):
        file, _, anchor = link.partition("#")
        assert not anchor or not file.endswith(("answers.md", "results.md"))  # empty for students
        path = (document.parent / file).resolve() if file else document
        assert path.exists(), link
        headings = re.findall(r"^#+ (.*)$", path.read_text("utf-8"), re.M) if anchor else []
        found = {re.sub(r"[^\w -]", "", x.lower()).replace(" ", "-") for x in headings}
        assert not anchor or anchor in found, link
