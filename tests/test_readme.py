"""README and docs stay true: commands, snippets, flags, links and names."""

import argparse
import importlib
import inspect
import re
import subprocess
import sys

import gymnasium as gym
import harness
import numpy as np
import pytest
from benchmark import common
from benchmark.__main__ import make_parser
from conftest import SCRIPTS

DOCUMENTS = [harness.ROOT / "README.md", *sorted((harness.ROOT / "docs").glob("*.md"))]
TEXT = "\n".join(path.read_text(encoding="utf-8") for path in DOCUMENTS)
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
LINES = [line.split("#")[0].strip() for kind, block in BLOCKS if not kind
         for line in block.splitlines()]
INLINE = re.findall(r"`([^`]+)`", re.sub(r"^```.*?^```", "", TEXT, flags=re.DOTALL | re.MULTILINE))
COMMANDS = [" ".join(x.split()) for x in (*LINES, *INLINE)]
# Without paths that only a user's machine has, or that stand for many.
SCRIPT_CALLS = sorted({
    match for x in COMMANDS for match in re.findall(r"python ((?:[a-z0-9_]+)\.py(?: .*)?)$", x)
    if not re.search(r"my_\w+\.py|--watch|--resume|SEED|SLURM", match)})
STUDIES = sorted({
    match for x in COMMANDS for match in re.findall(r"python tests/benchmark (.*)$", x)})
SNIPPETS = [block for kind, block in BLOCKS if kind == "python"]


def snippet(words):
    (block,) = [x for x in SNIPPETS if words in x]
    return block


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A new folder, in which my_module.py lies."""
    (tmp_path / "my_module.py").write_text(snippet("class Push"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("call", SCRIPT_CALLS)
def test_every_call_of_a_script_makes_an_update(call, here):
    file, *flags = call.split()
    name = file.removesuffix(".py")
    module = importlib.import_module(name)
    if "--help" in flags:
        with pytest.raises(SystemExit, match="0"):
            module.parse_args(flags)
        return
    *_, updates = common.begin(name, module.parse_args(flags), seed=1)
    next(updates)
    env_step, *_ = next(updates)
    assert env_step > 0


def test_there_are_calls_to_test():
    assert len(SCRIPT_CALLS) > 5
    assert len(STUDIES) > 5


@pytest.mark.parametrize("call", STUDIES)
def test_every_call_of_the_benchmark_has_the_arguments_that_it_takes(call):
    assert make_parser().parse_args(re.sub("…|STUDY", "returns", call).split())


def test_the_environment_of_your_own_is_checked_and_played(here):
    out = subprocess.run([sys.executable, *harness.STRICT, "my_module.py"], check=True, text=True,
                         capture_output=True).stdout
    assert "return with random actions" in out


def test_a_wrapper_of_your_own_makes_a_flat_box_and_can_be_drawn():
    class MyEnv(gym.Env):
        metadata = {"render_modes": ["rgb_array"], "render_fps": 20}
        observation_space = gym.spaces.Dict(x=gym.spaces.Box(-1.0, 1.0, (2,)),
                                            mode=gym.spaces.Discrete(3))
        action_space = gym.spaces.Box(-1.0, 1.0, (1,))

        def __init__(self, render_mode=None):
            self.render_mode = render_mode

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            return self.observation_space.sample(), {}

        def render(self):
            return np.zeros((4, 4, 3), np.uint8)

    exec(snippet("FlattenObservation"), {"gym": gym, "MyEnv": MyEnv})
    make_envs = importlib.import_module("ppo_continuous").make_envs
    envs = make_envs("My-v0", 1, "NextStep", render_mode="rgb_array_list")
    envs.reset(seed=1)
    assert envs.single_observation_space.shape == (5,)
    assert len(envs.render()[0]) == 1


def test_an_existing_task_can_be_wrapped_and_drawn():
    (entry_point,) = re.findall(r"`gym\.spec\((\S+)\)\.entry_point`", TEXT)
    entry_point = gym.spec(entry_point.strip('"')).entry_point
    exec(snippet("FlattenObservation").replace("My-v0", "Lake-v0"),
         {"gym": gym, "MyEnv": entry_point})
    make_envs = importlib.import_module("a2c_vector").make_envs
    envs = make_envs("Lake-v0", 1, "NextStep", render_mode="rgb_array_list")
    envs.reset(seed=1)
    assert envs.single_observation_space.shape == (16,)
    assert len(envs.render()[0]) == 1


def test_the_loop_of_your_own_runs(here, capsys):
    exec(snippet("for env_step, episodes").replace("30000", "3000"), {})
    assert re.search(r"\d+ steps, return \d+, KL 0\.\d+", capsys.readouterr().out)


def test_the_trained_agent_of_your_code_plays_an_episode(here, capsys):
    folder = SCRIPTS["ppo_continuous"].train(here, env_id="my_module:Push-v0")
    exec(snippet("load_state_dict").replace("runs/…/seed-1", str(folder)), {})
    assert re.fullmatch(r"return: [\d.]+\n", capsys.readouterr().out.splitlines(True)[-1])


@pytest.mark.parametrize(("words", "shown"), [
    ("5 steps of reward 1", [4.0951, 3.439, 2.71, 1.9, 1]),
    ("one = torch.ones(4, 1)", [1.16, 0.8, -1, 0.8])])
def test_cells_that_take_a_function_apart_show_what_the_text_says(words, shown):
    setup, last = snippet(words).split("\ncompute_gae(")
    scope = {}
    exec(setup, scope)
    advantages = eval(f"compute_gae({last}", scope).flatten().tolist()
    assert advantages == pytest.approx(shown)
    assert all(f"{x:g}".replace("-", "−") in TEXT for x in shown)


def test_every_snippet_compiles():
    for block in SNIPPETS:
        compile(re.sub(r"^!.*$", "", block, flags=re.MULTILINE), "README", "exec")


def flags_of(parser):
    for action in parser._actions:
        yield from ((flag, action.help) for flag in action.option_strings)
        if isinstance(action, argparse._SubParsersAction):
            for study in action.choices.values():
                yield from flags_of(study)


def test_every_flag_in_the_text_exists():
    known = {flag for flag, _ in flags_of(make_parser())}
    for script in SCRIPTS.values():
        known |= {f"--{name.replace('_', '-')}" for name in vars(script.module.parse_args([]))}
    known |= {"--help", "--suppress-common-lines"}
    known |= {"--standalone", "--nproc-per-node"}  # of torchrun
    known |= {"--array", "--cpus-per-task", "--time"}  # of SLURM
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", TEXT)) <= known


def anchors(path):
    """Of its headings, as the sites that show Markdown make them."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", x.lower()).replace(" ", "-") for x in headings}


def test_links_inside_the_repository_resolve_and_no_picture_is_left_over():
    shown = set()
    for document in DOCUMENTS:
        links = re.findall(r"\]\(([^)\s]+)", document.read_text(encoding="utf-8"))
        for link in [x for x in links if "://" not in x]:
            file, _, anchor = link.partition("#")
            path = (document.parent / file).resolve() if file else document
            assert path.exists(), link
            assert not anchor or anchor in anchors(path), link
            shown.add(path)
    pictures = {x for kind in ("png", "gif") for x in (harness.ROOT / "docs").glob(f"*.{kind}")}
    assert pictures <= shown


def test_readme_is_short():
    """Two screens: 220 lines, and 1,500 words outside of code and tables."""
    text = DOCUMENTS[0].read_text(encoding="utf-8")
    assert text.count("\n") <= 220
    prose = re.sub(r"^```.*?^```|^\|.*?$|^<!--.*?$", "", text, flags=re.DOTALL | re.MULTILINE)
    assert len(prose.split()) <= 1500


def test_every_function_and_test_that_is_named_exists():
    sources = "\n".join(x.read_text(encoding="utf-8") for x in harness.TESTS.glob("*.py"))
    for name in re.findall(r"`(test_\w+)`", TEXT):
        assert f"def {name}(" in sources, name
    table = TEXT.split("| in the mathematics | in the code |")[1].split("\n\n")[0]
    names = re.findall(r"`(\w+)`", table)
    assert len(names) > 5
    modules = [x.module for x in SCRIPTS.values()]
    for name in names:
        assert any(inspect.isfunction(getattr(x, name, None)) for x in modules), name


def numbers(cell):
    return [float(x.replace("−", "-").replace(",", "")) for x in re.findall(r"[−\d.]+", cell)]


def test_tasks_and_symbols_are_those_of_the_defaults():
    for name in SCRIPTS:
        env = gym.make(common.defaults(name)["env_id"])
        (row,) = re.findall(rf"^\| {env.spec.id} \| \d numbers.*$", TEXT, re.MULTILINE)
        _, _, state, action, *_ = row.split("|")
        assert state.startswith(f" {env.observation_space.shape[0]} numbers:")
        if isinstance(env.action_space, gym.spaces.Box):
            assert numbers(action) == [env.action_space.low.item(), env.action_space.high.item()]
        else:
            assert numbers(action) == [env.action_space.n]
        assert env.spec.max_episode_steps == 1000
    for flag in "gamma", "gae_lambda", "clip_eps":
        (row,) = re.findall(rf"^\| . \| `--{flag.replace('_', '-')}` \|.*$", TEXT, re.MULTILINE)
        for cell, script in zip(row.split("|")[3:6], SCRIPTS):
            assert cell.strip() == str(common.defaults(script).get(flag, "–")), flag
