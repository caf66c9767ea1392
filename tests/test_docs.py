"""README and docs: commands and snippets run, options exist, links resolve."""

import re
import subprocess
import sys

import harness
import pytest
from conftest import SCRIPTS

DOCUMENTS = [path for pattern in ("*.md", "docs/*.md", "experiments/data/*.md")
             for path in sorted(harness.ROOT.glob(pattern))]
TEXT = "\n".join(path.read_text(encoding="utf-8") for path in DOCUMENTS)
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
SHELL = "\n".join(block for kind, block in BLOCKS if not kind)
SHELL += "\n" + "\n".join(" ".join(x.split()) for x in re.findall(
    r"`([^`]+)`", re.sub(r"^```.*?^```", "", TEXT, flags=re.DOTALL | re.MULTILINE)))
# Without those whose paths only a user has.
CALLS = sorted({
    (file, options.strip()) for file, options in re.findall(
        r"python (\w+\.py)((?: --[a-z-]+(?: [\w.:/-]+)*)*)", SHELL)
    if file.removesuffix(".py") in SCRIPTS and not re.search("watch|help|SEED|--seed$", options)})
SNIPPETS = [block for kind, block in BLOCKS if kind == "python"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A new folder, in which my_module.py lies."""
    module = "\n".join(x for x in SNIPPETS if "gym.register" in x)
    (tmp_path / "my_module.py").write_text(module, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


@pytest.mark.parametrize(("file", "options"), CALLS)
def test_every_call_of_a_script_trains(file, options, here, monkeypatch):
    module = SCRIPTS[file.removesuffix(".py")].module
    sizes = "--total-steps", 64, "--eval-episodes", 1, "--num-evals", 1
    assert len(harness.train(monkeypatch, module, *options.split(), *sizes))


def test_the_environment_of_your_own_is_checked(here):
    subprocess.run([sys.executable, *harness.STRICT, "my_module.py"], check=True)


def test_the_code_that_the_readme_shows_stands_in_the_file():
    (block,) = [x for x in SNIPPETS if "def policy_loss" in x]
    file = (harness.ROOT / "ppo_continuous.py").read_text(encoding="utf-8")
    assert all(part in file for part in block.split("    …\n"))


def test_a_trained_agent_plays_in_code_of_your_own(tmp_path):
    (block,) = [x for x in SNIPPETS if "import ppo_continuous" in x]
    path = SCRIPTS["ppo_continuous"].train(tmp_path)
    played = {}
    exec(block.replace("runs/…/seed-1", str(path)), played)
    assert played["terminated"] or played["truncated"]


@pytest.mark.skipif("**For teachers.**" not in TEXT, reason="a students' copy, without answers")
def test_exercise_9_and_its_answer_run(tmp_path, capsys):
    (sheet,), (answer,) = ([x for x in SNIPPETS if text in x] for text in ("rf.play", "for b in"))
    path = SCRIPTS["reinforce_mujoco"].train(tmp_path)
    exec(sheet.replace("runs/…/seed-1", str(path)) + answer, {})
    of_nothing, of_mean, *others = map(float, capsys.readouterr().out.split())
    assert of_mean < of_nothing
    assert len(others) == 3


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_no_formula_that_is_wrapped_begins_a_quotation_or_a_list(document):
    assert not re.findall(r"^ *[>+] .*", document.read_text(encoding="utf-8"), re.MULTILINE)


def test_every_option_in_the_text_exists():
    known = {"--help", "--suppress-common-lines", "--standalone", "--nproc-per-node",
             "--array", "--wrap", "--tb", "--with", "--with-requirements",  # of diff, torchrun,
             "--quick", "--again", "--only"}  # SLURM, pytest, uv; of a study
    for script in SCRIPTS.values():
        known |= {f"--{name.replace('_', '-')}" for name in vars(script.module.parse_args([]))}
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
