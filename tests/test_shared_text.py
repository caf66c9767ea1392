"""What the three files have in common is the same, word for word."""

import ast
import difflib
import re

from conftest import SCRIPTS
from harness import ROOT

# Where the scripts differ on purpose, because this is the algorithm, or its options.
DIFFERENT = {
    "Agent", "Transitions", "main", "make_envs", "mlp", "optimise", "parse_args", "plot",
    "policy_loss", "train", "watch"}
ALIKE_IN_TWO = {"mlp": {"reinforce_mujoco", "ppo_continuous"}}


def sources():
    """{name of function or class: {script: its text}}"""
    found = {}
    for script in SCRIPTS.values():
        text = (ROOT / script.file).read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.col_offset == 0:
                found.setdefault(node.name, {})[script.name] = ast.get_source_segment(text, node)
    return found


def test_functions_of_the_same_name_have_the_same_text():
    found = sources()
    assert {"evaluate", "save", "compute_gae", "rollout", "Tidy"} <= set(found) - DIFFERENT
    for name, versions in found.items():
        alike = ALIKE_IN_TWO.get(name, set() if name in DIFFERENT else set(versions))
        (first, text), *others = [(x, versions[x]) for x in versions if x in alike] or [("", "")]
        for other, its_text in others:
            diff = difflib.unified_diff(
                text.splitlines(), its_text.splitlines(), first, other, lineterm="")
            assert text == its_text, "\n".join(diff)


def test_requirements_txt_is_what_the_scripts_ask_for_and_pytest():
    listed = (ROOT / "requirements.txt").read_text().splitlines()
    listed = {line for line in listed if line and not line.startswith("#")}
    asked = set()
    for script in SCRIPTS.values():
        text = (ROOT / script.file).read_text(encoding="utf-8")
        block = re.match(r"(?s)# /// script\n(.*?)\n# ///\n", text).group(1)
        assert '# requires-python = ">=3.10,<3.14"\n' in block
        packages = re.findall(r'"([^"]+)"[,\]]', block)
        extra = "box2d" if script.name == "a2c_vector" else "mujoco"
        assert any(x.startswith("mujoco") for x in packages) == (extra == "mujoco")
        asked |= {x.replace(f"[{extra}]", "[mujoco,box2d]") for x in packages}
    (pytest_line,) = listed - asked
    assert pytest_line.startswith("pytest>=")
    assert asked < listed
