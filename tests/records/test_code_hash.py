"""The hash of the code that results depend on: blind to what changes nothing, and to nothing else."""

import sys

import pytest

from agents.records import code_hash as module
from agents.records.code_hash import ALL, code_hash, method_roots
from probe_env.physics.methods import METHODS

PROGRAM = {
    "__init__": "",
    "work": '''
"""Docstring."""
from probe_env.parts import Machine, SCALE
import probe_env.tools as tools

def run(machine: Machine, times: int = 3) -> float:
    """Docstring."""
    if times < 0:
        raise ValueError(f"times = {times}")
    return machine.step(times) * SCALE + tools.offset()
''',
    "parts": """
SCALE = 2.0
UNUSED = 7

class Machine:
    size = 4

    def step(self, times):
        return self.size * times

    def unused(self):
        return 0
""",
    "tools": """
def offset():
    return 1.0
""",
}


@pytest.fixture
def hash_of(tmp_path, monkeypatch):
    """The hash of ``work:run`` in a package of these files, under the name of ours."""

    def hashed(files):
        folder = tmp_path / str(len(list(tmp_path.iterdir()))) / "probe_env"
        folder.mkdir(parents=True)
        for name, text in files.items():
            (folder / f"{name}.py").write_text(text)

        def path(name):
            place = folder.joinpath(*name.split(".")[1:])
            return next((p for p in (place / "__init__.py", place.with_suffix(".py")) if p.is_file()), None)

        monkeypatch.setattr(module, "_path", path)
        module._module.cache_clear()
        code_hash.cache_clear()
        return code_hash(("probe_env.work:run",))

    yield hashed
    monkeypatch.undo()
    module._module.cache_clear()
    code_hash.cache_clear()


SAME = {
    "comment and layout": ("work", "times: int = 3", "times:int   =   3,  # how often\n"),
    "docstring": ("work", '"""Docstring."""\n    if', '"""Another."""\n    if'),
    "annotation": ("work", "-> float", "-> int"),
    "wording of an error": ("work", "times = {times}", "times = {times} is negative"),
    "check": ("work", "    return machine", "    check_times(times)\n    return machine"),
    "constant that is not used": ("parts", "UNUSED = 7", "UNUSED = 8"),
    "method that is not used": ("parts", "return 0", "return 1"),
    "import": ("work", "import probe_env.tools as tools", "import math\nimport probe_env.tools as tools"),
}
OTHER = {
    "constant": ("parts", "SCALE = 2.0", "SCALE = 2.5"),
    "default": ("work", "times: int = 3", "times: int = 4"),
    "method of an annotated class": ("parts", "self.size * times", "self.size + times"),
    "field of a class": ("parts", "size = 4", "size = 5"),
    "function behind a module": ("tools", "return 1.0", "return 2.0"),
    "condition of an error": ("work", "times < 0", "times < 1"),
}


@pytest.mark.parametrize("change", SAME)
def test_what_changes_nothing_is_not_seen(hash_of, change):
    name, before, after = SAME[change]
    assert before in PROGRAM[name]
    assert hash_of(PROGRAM | {name: PROGRAM[name].replace(before, after)}) == hash_of(PROGRAM)


@pytest.mark.parametrize("change", OTHER)
def test_what_changes_results_is_seen(hash_of, change):
    name, before, after = OTHER[change]
    assert before in PROGRAM[name]
    assert hash_of(PROGRAM | {name: PROGRAM[name].replace(before, after)}) != hash_of(PROGRAM)


def test_a_method_that_a_result_never_runs_can_be_left_out(hash_of):
    """As how tubes of a plant are drawn, of results of the shipped tubes."""
    changed = PROGRAM | {"parts": PROGRAM["parts"].replace("self.size * times", "self.size + times")}

    def without(name):
        module._module.cache_clear()
        return code_hash(("probe_env.work:run",), without=(f"probe_env.parts:Machine.{name}",))

    hash_of(PROGRAM)
    one, unused = without("step"), without("unused")
    assert (hash_of(PROGRAM) == unused, hash_of(PROGRAM) == one) == (True, False)
    hash_of(changed)
    assert (without("step") == one, without("unused") == unused) == (True, False)


def test_a_class_that_never_runs_can_be_left_out(hash_of):
    """As how both passes are judged, of results of one."""
    changed = PROGRAM | {"parts": PROGRAM["parts"].replace("self.size * times", "self.size + times")}

    def without(*names):
        module._module.cache_clear()
        return code_hash(("probe_env.work:run",), without=names)

    whole = hash_of(PROGRAM)
    left_out = without("probe_env.parts:Machine")
    assert left_out != whole
    assert hash_of(changed) != whole
    assert without("probe_env.parts:Machine") == left_out


def test_a_definition_may_move_to_another_file(hash_of):
    moved = PROGRAM | {
        "work": PROGRAM["work"].replace("import probe_env.tools as tools", "from probe_env import shed as tools"),
        "shed": PROGRAM["tools"],
    }
    del moved["tools"]
    assert hash_of(moved) == hash_of(PROGRAM)
    split = PROGRAM | {
        "parts": PROGRAM["parts"].replace("SCALE = 2.0\n", "from probe_env.numbers import SCALE\n"),
        "numbers": "SCALE = 2.0\n",
    }
    assert hash_of(split) == hash_of(PROGRAM)


def test_a_definition_may_be_imported_by_itself_or_under_another_name(hash_of):
    """Such as ``parts.SCALE`` or ``tools.offset``, which move to other modules with other names."""
    _, body = PROGRAM["work"].split("\n\n", 1)
    by_itself = "from probe_env.parts import Machine as Engine, SCALE as K\nfrom probe_env.tools import offset"
    body = body.replace("tools.offset", "offset").replace("* SCALE", "* K").replace(": Machine", ": Engine")
    assert hash_of(PROGRAM | {"work": f"{by_itself}\n\n{body}"}) == hash_of(PROGRAM)
    assert hash_of(PROGRAM | {"work": f"{by_itself}\n\n{body.replace('* K', '* 2')}"}) != hash_of(PROGRAM)


def test_a_place_changes_nothing_but_what_a_function_does_with_one_counts(hash_of):
    """A constant made of ``__file__`` leads to an input; nothing else can be hidden by naming it."""

    def tools(place):
        return PROGRAM | {"tools": place + "\ndef offset():\n    return float(PLACE.name)\n"}

    def within(place):
        return PROGRAM | {"tools": f"def offset():\n    place = {place}\n    return float(place.name)\n"}

    here, above = "Path(__file__).parent", "Path(__file__).parents[1]"
    assert hash_of(tools(f"PLACE = {here}")) == hash_of(tools(f"PLACE: Final = {above}"))
    assert hash_of(tools(f"PLACE = {here}")) != hash_of(tools("PLACE = Path('other')"))
    assert hash_of(within(here)) != hash_of(within(above))


def test_the_form_is_the_same_for_every_python(hash_of):
    """Found on 3.11.7, 3.12.1 and 3.13.0; ``ast.dump``, the form before, gave three hashes."""
    assert hash_of(PROGRAM) == "d3cf73e8569ed4da", sys.version


def test_an_evaluation_depends_on_task_kpis_and_signals_and_on_its_own_method_alone():
    code_hash.cache_clear()
    episodes = ("probe_env.envs.episodes:Episodes.step",)
    reached = {text.split(" ")[0] for text in module._texts((*episodes, *method_roots("imex32")))}
    assert reached >= {"window_statistics", "Tally.kpis", "TaskConfig.targets", "imex_advance", "Chain", "Drive"}
    assert not reached & {"ticm_step", "solve_banded_step", "node_equation", "explicit_advance", "implicit_step"}
    newmark, lanes = (code_hash(("agents.studies.claims.cases:run_case",), method) for method in ("newmark", "imex32"))
    assert newmark != lanes


def test_all_methods_and_solvers_have_a_place():
    assert method_roots("imex32") == ("probe_env.physics.methods.imex:IMEX32",)
    newmark = "probe_env.physics.methods.newmark:NEWMARK"
    assert method_roots("banded") == (newmark, "probe_env.physics.methods.banded:stepper")
    assert set(method_roots(ALL)) >= {
        f"probe_env.physics.methods.{name.rstrip('32')}:{name.upper()}" for name in METHODS if name != "wilson"
    }


def test_a_root_that_is_not_there_is_named():
    with pytest.raises(ValueError, match="there is no run_nothing"):
        code_hash(("agents.studies.claims.cases:run_nothing",))
