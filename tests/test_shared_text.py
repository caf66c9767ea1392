"""What the three files have in common is the same, word for word."""

import ast
import re

from conftest import SCRIPTS
from harness import ROOT

TEXTS = {name: (ROOT / f"{name}.py").read_text(encoding="utf-8") for name in SCRIPTS}
SHARED = {  # name: the files that have it (R, A, P), those with the same text in one word
    **dict.fromkeys(["bounded", "plot"], "RAP"),
    **dict.fromkeys(["RunningStatistics", "compute_gae", "rollout"], "AP"),
    **dict.fromkeys(["evaluate", "main", "watch"], "AP R"),  # an environment is no vector
    **dict.fromkeys(["Agent", "optimise", "parse_args", "policy_loss", "train"], "A P R"),
    "Transitions": "A P", "make_envs": "A P", "mlp": "A RP"}


def test_functions_of_the_same_name_have_the_same_text_in_these_files():
    found = {}
    for file, text in TEXTS.items():
        for node in ast.parse(text).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                source = ast.get_source_segment(text, node)
                found.setdefault(node.name, {}).setdefault(source, []).append(file[0].upper())
    found = {name: " ".join(sorted("".join(files) for files in groups.values()))
             for name, groups in found.items()}
    groups = {name: sorted(words.split()) for name, words in found.items() if len(words) > 1}
    assert groups == {name: sorted(words.split()) for name, words in SHARED.items()}


def test_requirements_txt_is_what_the_scripts_ask_for():
    listed = set((ROOT / "requirements.txt").read_text().splitlines())
    for name, text in TEXTS.items():
        block = re.match(r"(?s)# /// script\n(.*?)\n# ///\n", text).group(1)
        extra = "box2d" if name == "a2c_vector" else "mujoco"
        packages = re.findall(r'"([^"]+)"[,\]]', block)
        assert any(x.startswith("mujoco") for x in packages) == (extra == "mujoco")
        assert {x.replace(f"[{extra}]", "[mujoco,box2d]") for x in packages} < listed
