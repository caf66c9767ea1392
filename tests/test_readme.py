"""The README stays true: commands, snippets, flags, links and names."""

import argparse
import ast
import importlib
import inspect
import io
import os
import re
import subprocess
import sys
import tokenize

import benchmark
import gymnasium as gym
import harness
import pandas as pd
import pytest

TEXT = (harness.ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
LINES = [line.split("#")[0].strip() for kind, block in BLOCKS if not kind
         for line in block.splitlines()]
INLINE = re.findall(r"`([^`]+)`", re.sub(r"^```.*?^```", "", TEXT, flags=re.DOTALL | re.MULTILINE))
COMMANDS = [" ".join(x.split()) for x in (*LINES, *INLINE)]
# Without paths that only a user's machine has, or that stand for many.
SCRIPT_CALLS = sorted({
    match for x in COMMANDS for match in re.findall(r"python ((?:[a-z0-9_]+)\.py(?: .*)?)$", x)
    if not re.search(r"my_module\.py|--watch|--resume|SEED|SLURM", match)})
STUDIES = sorted({
    match for x in COMMANDS for match in re.findall(r"python tests/benchmark\.py (.*)$", x)})
SNIPPETS = [block for kind, block in BLOCKS if kind == "python"]
SCRIPTS = benchmark.SCRIPTS


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
    name, *flags = call.split()
    module = importlib.import_module(name.removesuffix(".py"))
    if "--help" in flags:
        with pytest.raises(SystemExit, match="0"):
            module.parse_args(flags)
        return
    _, updates = benchmark.begin(module, module.parse_args(flags), seed=1)
    next(updates)
    env_step, *_ = next(updates)
    assert env_step > 0


def test_there_are_calls_to_test():
    assert len(SCRIPT_CALLS) > 5
    assert len(STUDIES) > 5


@pytest.mark.parametrize("call", STUDIES)
def test_every_call_of_the_benchmark_has_the_arguments_that_it_takes(call):
    args = benchmark.parse_args(call.replace("…", "x").split())
    assert callable(args.function)


def test_the_environment_of_your_own_is_checked_and_played(here):
    out = subprocess.run([sys.executable, *harness.STRICT, "my_module.py"], check=True, text=True,
                         capture_output=True).stdout
    assert "return with random actions" in out


def test_the_loop_of_your_own_runs(here, capsys):
    exec(snippet("for env_step, episodes").replace("30000", "3000"), {})
    assert re.search(r"\d+ steps, return \d+, KL 0\.\d+", capsys.readouterr().out)


def test_the_cell_of_the_notebook_that_takes_a_function_apart_gives_discounted_returns():
    setup, last = snippet("compute_gae(rewards").split("\ncompute_gae(")
    scope = {}
    exec(setup, scope)
    advantages = eval(f"compute_gae({last}", scope).flatten().tolist()
    assert advantages == pytest.approx([4.0951, 3.439, 2.71, 1.9, 1])


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
    known = {flag for flag, _ in flags_of(benchmark.make_parser())}
    for module in SCRIPTS.values():
        known |= {f"--{name.replace('_', '-')}" for name in vars(module.parse_args([]))}
    known |= {"--help", "--suppress-common-lines"}
    known |= {"--standalone", "--nproc-per-node", "--nnodes", "--rdzv-endpoint"}  # of torchrun
    known |= {"--array", "--cpus-per-task", "--time"}  # of SLURM
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", TEXT)) <= known


def test_links_inside_the_repository_resolve_and_no_asset_is_left_over():
    links = {x for x in re.findall(r"\]\(([^)#\s]+)", TEXT) if "://" not in x}
    assert links
    for link in links:
        assert (harness.ROOT / link).exists(), link
    assets = {f"assets/{x}" for x in os.listdir(harness.ROOT / "assets")}
    assert assets == {x for x in links if x.startswith("assets/")}


def test_every_function_and_test_that_is_named_exists():
    sources = "\n".join(x.read_text(encoding="utf-8") for x in harness.TESTS.glob("*.py"))
    for name in re.findall(r"`(test_\w+)`", TEXT):
        assert f"def {name}(" in sources, name
    table = TEXT.split("| in the mathematics | in the code |")[1].split("\n\n")[0]
    names = re.findall(r"`(\w+)`", table)
    assert len(names) > 5
    for name in names:
        assert any(inspect.isfunction(getattr(x, name, None)) for x in SCRIPTS.values()), name


def numbers(cell):
    return [float(x.replace("−", "-").replace(",", "")) for x in re.findall(r"[−\d.]+", cell)]


def rounded(column, digits):
    return [round(x, digits) for x in column]


def test_the_table_of_ppo_is_that_of_the_csv_file():
    data = pd.read_csv(harness.ROOT / "assets/ppo_returns.csv").sort_values("seed")
    suite = data[data["total_steps"] == 1_000_000].copy()
    assert suite["flags"].dropna().unique() == ["--log-std -1.0"]
    suite.loc[suite["flags"].notna(), "env_id"] += ", with `--log-std -1`"
    assert len(suite["env_id"].unique()) == 1 + len(benchmark.PUBLISHED)
    for env_id, runs in suite.groupby("env_id"):
        (row,) = re.findall(rf"^\| {env_id} \|.* \[.\] \|$", TEXT, re.MULTILINE)
        _, _, spread, every, sampled, published, _ = row.split("|")
        returns = runs["eval_return_mean"]
        assert runs["seed"].tolist() == benchmark.SEEDS[benchmark.PPO]
        assert numbers(every) == rounded(returns, 1)
        assert numbers(spread) == rounded([returns.mean(), returns.std()], 1)
        assert numbers(sampled) == rounded([runs["last_100_returns"].mean()], 1)
        assert numbers(published.split("[")[0]) == [benchmark.PUBLISHED[env_id.split(",")[0]]]
    usual = data[data["total_steps"] == benchmark.DEFAULTS[benchmark.PPO]["total_steps"]]
    assert len(usual) == 5
    assert ", ".join(f"{x:.1f}" for x in usual["eval_return_mean"]) in " ".join(TEXT.split())


def test_tables_of_a2c_and_reinforce_are_those_of_the_csv_files():
    data = pd.read_csv(harness.ROOT / "assets/a2c_returns.csv")
    data = data[data["flags"].isna()].sort_values("seed")
    for steps in 1_000_448, 3_000_320:
        runs = data[data["env_steps"].eq(steps)]
        assert runs["seed"].tolist() == list(range(1, 11))
        (row,) = re.findall(rf"^\| {steps:,} \|[^|]*\|[^|]*\|$", TEXT, re.MULTILINE)
        _, _, spread, every, _ = row.split("|")
        returns = runs["eval_return_mean"]
        assert numbers(every) == rounded(returns, 1)
        assert numbers(spread) == rounded([returns.mean(), returns.std()], 1)
    data = pd.read_csv(harness.ROOT / "assets/baselines.csv")
    noise = pd.read_csv(harness.ROOT / "assets/variance.csv").set_index("baseline")["relative"]
    for name, runs in data.groupby("flags"):
        name = name.split()[1]
        (row,) = re.findall(rf"^\| `{name}`.*\d \|$", TEXT, re.MULTILINE)
        _, _, variance, every, training, _ = row.split("|")
        assert numbers(variance) == [round(noise[name], 2)]
        assert numbers(every) == rounded(runs["eval_return_mean"], 0)
        assert numbers(training) == rounded(runs["last_100_returns"], 0)


@pytest.mark.parametrize(
    ("name", "steps"), [("robustness", 3_000_320), ("robustness_1m", 1_000_448)])
def test_the_table_of_robustness_is_that_of_the_csv_files(name, steps):
    data = pd.read_csv(harness.ROOT / f"assets/{name}.csv")
    usual = data["gravity"].eq(-10) & data["wind_power"].eq(0)
    edge = data["gravity"].isin((-2, -11.9)) | data["wind_power"].isin((0, 20))
    for cell, worlds in ((3, usual | True), (4, edge), (5, usual)):
        agents = data[worlds].groupby(["trained", "seed"])["return_mean"].mean()
        for trained in "default", "--randomize":
            (row,) = re.findall(rf"^\| {steps:,} \| `?{trained}`? \|.*$", TEXT, re.MULTILINE)
            x = agents[trained]
            assert len(x) == 10
            assert numbers(row.split("|")[cell]) == rounded([x.mean(), x.std()], 1)
        (row,) = re.findall(rf"^\| {steps:,} \| difference, 95%.*$", TEXT, re.MULTILINE)
        gap, _, margin = benchmark.difference(agents["--randomize"], agents["default"])
        assert numbers(row.split("|")[cell]) == rounded([gap, margin], 1)


def test_the_words_about_robustness_are_those_of_the_csv_file():
    data = pd.read_csv(harness.ROOT / "assets/robustness.csv")
    x = data.groupby(["trained", "seed"])["return_mean"].mean()
    gap, error, margin = benchmark.difference(x["--randomize"], x["default"])
    text = " ".join(TEXT.split())
    assert f"{gap:.0f} points more over 30 worlds" in text
    assert f"(95% interval {gap - margin:.0f} to {gap + margin:.0f})" in text
    assert f"over all worlds is {gap / error:.1f} standard errors" in text
    worlds = data.pivot_table(index="gravity", columns="trained", values="return_mean")
    gaps = worlds["--randomize"] - worlds["default"]
    found = re.search(r"from −2 to −11.9, over all winds, it is (.*?)\. ", text)[1]
    assert numbers(found) == rounded(gaps.sort_index(ascending=False), 0)


def test_the_tables_of_the_ablation_are_those_of_the_csv_file():
    data = pd.read_csv(harness.ROOT / "assets/ablation.csv")
    assert list(data["variant"].unique()) == list(benchmark.ABLATIONS)
    for _, runs in data.groupby(["env_id", "variant"]):
        assert runs["seed"].tolist() == benchmark.SEEDS[benchmark.PPO]
    for env_id, table in benchmark.ablation_table(data).groupby("environment"):
        rows = TEXT.split(f"\n| {env_id}, 500,000 steps |")[1].split("\n\n")[0]
        assert rows.count("\n") == len(table) + 1
        for x in table.itertuples():
            (row,) = re.findall(rf"^\| {x.variant} \|(.*)\|$", rows, re.MULTILINE)
            spread, gap, every = row.split("|")
            assert numbers(spread) == rounded([x.mean, x.std], 0)
            assert every.strip().replace("−", "-") == x.seeds
            if x.variant != "defaults":
                assert numbers(gap) == rounded([x.difference, x.margin], 0)


def test_the_tables_of_the_races_are_those_of_the_csv_files():
    files = {"ppo_race": None, "a2c_race": "1,000,000 steps", "a2c_race_200k": "200,000 steps"}
    for name, label in files.items():
        data = pd.read_csv(harness.ROOT / f"assets/{name}.csv")
        for _, runs in data.groupby(["env_id", "learner"]):
            assert sorted(runs["seed"].unique()) == [1, 2, 3]
        rows = benchmark.race_rows(data)
        assert len(rows) == (2 if label else 9)
        for env_id, *cells in rows:
            row = " | ".join([label or env_id, *cells])
            assert f"| {row} |" in TEXT.replace("−", "-")


def test_the_table_of_scaling_is_that_of_the_csv_file():
    data = pd.read_csv(harness.ROOT / "assets/scaling.csv")
    for (measure, kind), speeds in data.groupby(["measure", "vectorization"]):
        end = "one process" if kind == "sync" else "a process each, `--vectorization async`"
        cells = " | ".join(f"{x:.0f}" for x in speeds["speed"])
        assert f"| {measure} | {end} | {cells} |" in TEXT


def test_the_answers_to_the_exercises_are_those_of_the_csv_file():
    data = pd.read_csv(harness.ROOT / "assets/exercises.csv")
    assert list(data) == list(benchmark.EXERCISES)
    answers = TEXT.split("<summary>Answers")[1]
    for number, returns in enumerate(data.to_numpy().T, start=1):
        (cell,) = re.findall(rf"^\| {number} \| ([^|]*) \|", answers, re.MULTILINE)
        assert numbers(cell) == rounded(returns, 0)


def test_tasks_and_symbols_are_those_of_the_defaults():
    for defaults in benchmark.DEFAULTS.values():
        env = gym.make(defaults["env_id"])
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
        cells = zip(row.split("|")[3:6], (benchmark.REINFORCE, benchmark.A2C, benchmark.PPO))
        for cell, script in cells:
            assert cell.strip() == str(benchmark.DEFAULTS[script].get(flag, "–")), flag


def test_the_table_at_the_top_counts_lines_right():
    for name, module in SCRIPTS.items():
        (row,) = re.findall(rf"^\| `{name}\.py` \|.*seeds.*\|$", TEXT, re.MULTILINE)
        above, total = code_lines(module)
        assert f"| {total} ({above}) |" in row, (name, total, above)


def code_lines(module):
    """Lines of code, neither blank nor comment nor docstring: above the rule, and in all."""
    text = inspect.getsource(module)
    docs = set()
    for node in ast.walk(ast.parse(text)):
        kinds = ast.Module, ast.FunctionDef, ast.ClassDef
        if isinstance(node, kinds) and ast.get_docstring(node):
            docs.update(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    skip = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
            tokenize.ENDMARKER}
    lines = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in skip:
            lines.update(range(token.start[0], token.end[0] + 1))
    rule = text[:text.index("\n# =====")].count("\n") + 1
    return len([x for x in lines - docs if x <= rule]), len(lines - docs)
