"""What the three files have in common is the same, word for word."""

import ast
import re

from conftest import SCRIPTS
from harness import ROOT

TEXTS = {name: (ROOT / x.file).read_text(encoding="utf-8") for name, x in SCRIPTS.items()}
SHARED = {  # name: the files that have it (R, A, P), those with the same text in one word
    **dict.fromkeys(["check_finite", "evaluate", "in_range", "main", "make_repeatable",
                     "make_seeds", "plot", "save", "watch"], "RAP"),
    **dict.fromkeys(["RunningStatistics", "compute_gae", "rollout"], "AP"),
    **dict.fromkeys(["Agent", "make_envs", "optimise", "parse_args", "policy_loss", "train"],
                    "A P R"),  # the algorithm, and its options
    "Tidy": "AP R", "Transitions": "A P", "mlp": "A RP"}


def test_functions_of_the_same_name_have_the_same_text_in_these_files():
    found = {}
    for file, text in TEXTS.items():
        for node in ast.parse(text).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                source = ast.get_source_segment(text, node)
                found.setdefault(node.name, {}).setdefault(source, []).append(file[0].upper())
    found = {name: " ".join(sorted("".join(files) for files in groups.values()))
             for name, groups in found.items()}
    assert {name: groups for name, groups in found.items() if len(groups) > 1} == SHARED


def test_requirements_txt_is_what_the_scripts_ask_for_and_what_tests_and_experiments_need():
    listed = set((ROOT / "requirements.txt").read_text().splitlines())
    for name, text in TEXTS.items():
        block = re.match(r"(?s)# /// script\n(.*?)\n# ///\n", text).group(1)
        assert '# requires-python = ">=3.10,<3.14"\n' in block
        extra = "box2d" if name == "a2c_vector" else "mujoco"
        packages = re.findall(r'"([^"]+)"[,\]]', block)
        assert any(x.startswith("mujoco") for x in packages) == (extra == "mujoco")
        assert {x.replace(f"[{extra}]", "[mujoco,box2d]") for x in packages} < listed
    assert any(line.startswith("pytest") for line in listed)
