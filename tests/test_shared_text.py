"""What the three files have in common is the same, word for word."""

import ast
import re

from conftest import SCRIPTS
from harness import ROOT

VERSIONS = {  # of what differs on purpose, because this is the algorithm, or its options
    "Agent": 3, "main": 3, "optimise": 3, "parse_args": 3, "plot": 3, "policy_loss": 3, "train": 3,
    "watch": 3, "Transitions": 2, "make_envs": 2, "mlp": 2}


def test_functions_of_the_same_name_have_the_same_text():
    found = {}
    for script in SCRIPTS.values():
        text = (ROOT / script.file).read_text(encoding="utf-8")
        for node in ast.parse(text).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                found.setdefault(node.name, set()).add(ast.get_source_segment(text, node))
    assert {name: len(texts) for name, texts in found.items() if len(texts) > 1} == VERSIONS


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
