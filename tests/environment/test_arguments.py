"""What the environments say of arguments that they do not have, and of values that nearly fit."""

from __future__ import annotations

import inspect
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import pytest
from gymnasium.vector import AutoresetMode

from jackbox_env import JackInBoxEnv, JackInBoxVectorEnv
from jackbox_env.env import VECTOR_ONLY
from jackbox_env.sb3 import make_sb3_vec_env

ENTRIES: dict[str, Callable[..., Any]] = {
    "class": JackInBoxEnv,
    "make": lambda **given: gym.make("JackInBox-v0", **given),
    "sync": lambda **given: gym.make_vec("JackInBox-v0", num_envs=2, vectorization_mode="sync", **given),
    "vector class": lambda **given: JackInBoxVectorEnv(2, **given),
    "make_vec": lambda **given: gym.make_vec("JackInBox-v0", num_envs=2, **given),
}


@pytest.mark.parametrize("entry", ENTRIES)
def test_an_unknown_argument_is_told_the_closest_and_all(entry: str) -> None:
    with pytest.raises(TypeError) as refused:
        ENTRIES[entry](contct="exact")
    sentence = str(refused.value)
    assert "JackInBox-v0 has no argument 'contct' (did you mean 'contact'?): it takes " in sentence
    known = inspect.signature(JackInBoxVectorEnv if "vec" in entry else JackInBoxEnv).parameters
    assert ", ".join(known) in sentence
    assert "\n" not in sentence


@pytest.mark.parametrize("entry", ["class", "make", "sync"])
@pytest.mark.parametrize("name", ["with_infos", "num_threads"])
def test_arguments_of_the_native_vector_say_where_they_belong(entry: str, name: str) -> None:
    with pytest.raises(TypeError, match=f"has no argument '{name}': it belongs to the native vector environment: "):
        ENTRIES[entry](**{name: True})
    assert 'vectorization_mode="vector_entry_point"' in VECTOR_ONLY[name]


def test_the_native_vectors_own_arguments_are_known() -> None:
    own = inspect.signature(JackInBoxVectorEnv).parameters.keys() - inspect.signature(JackInBoxEnv).parameters.keys()
    assert own - {"max_episode_steps"} == VECTOR_ONLY.keys()  # gymnasium.make takes that one itself
    assert inspect.signature(JackInBoxEnv).parameters.keys() <= inspect.signature(JackInBoxVectorEnv).parameters.keys()


def test_the_docstring_has_a_row_for_each_argument() -> None:
    text = inspect.getdoc(JackInBoxEnv) or ""
    for name in inspect.signature(JackInBoxEnv).parameters:
        assert f"| `{name}`" in text, name
    vector_text = inspect.getdoc(JackInBoxVectorEnv) or ""
    for name in inspect.signature(JackInBoxVectorEnv).parameters:
        assert f"    {name}: " in vector_text, name


def test_unknown_keys_elsewhere_are_told_the_closest() -> None:
    with pytest.raises(ValueError, match=r"takes only .*, got 'with_info' \(did you mean 'with_infos'"):
        make_sb3_vec_env(2, with_info=True)
    with pytest.raises(ValueError, match=r"got 'scen' \(did you mean 'scene'\?\)"):
        JackInBoxEnv().reset(options={"scen": {}})
    with pytest.raises(ValueError, match="got 'xyz'$"):
        JackInBoxEnv().reset(options={"xyz": {}})


def test_a_tensor_with_gradients_is_told_to_detach() -> None:
    torch = pytest.importorskip("torch")
    single, several = JackInBoxEnv(), JackInBoxVectorEnv(2)
    single.reset()
    several.reset()
    with pytest.raises(TypeError, match=r"action must .*got a tensor that requires grad: pass its detach\(\)"):
        single.step(torch.ones(1, requires_grad=True))
    with pytest.raises(TypeError, match=r"actions must .*got a tensor that requires grad: pass its detach\(\)"):
        several.step(torch.ones(2, 1, requires_grad=True))
    single.step(torch.ones(1, requires_grad=True).detach())
    several.step(torch.ones(2, 1))


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_autoreset_mode_is_where_libraries_read_it(mode: AutoresetMode) -> None:
    """Gymnasium reads the metadata, TorchRL's wrapper the attribute."""
    env: Any = gym.make_vec("JackInBox-v0", num_envs=2, autoreset_mode=mode.name)
    assert env.autoreset_mode is mode
    assert env.metadata["autoreset_mode"] is mode


def test_single_environments_of_stable_baselines_have_a_spec() -> None:
    """It makes the same environment again, each of its own scene."""
    env = make_sb3_vec_env(
        2, scene=[{"gravity": 1.0}, {"gravity": 2.0}], task="spin", with_infos=True, num_threads=1, max_episode_steps=70
    )
    for number, spec in enumerate(env.get_attr("spec")):
        assert (spec.id, spec.max_episode_steps) == ("JackInBox-v0", 70)
        again: Any = gym.make(spec)
        assert (again.unwrapped.scene.gravity, again.unwrapped.task) == (1.0 + number, "spin")
    assert make_sb3_vec_env(1, max_episode_steps=-1).get_attr("spec")[0].max_episode_steps is None
    assert gym.spec("JackInBox-v0").kwargs == {}


@pytest.mark.parametrize(
    ("missing", "line", "sentence"),
    [
        (
            "stable_baselines3", "import jackbox_env.sb3",
            "jackbox_env.sb3 needs Stable-Baselines3, the extra 'train': in a checkout of jackbox, pip install -e "
            '".[train]"',
        ),
        ("stable_baselines3", "import jackbox_env.sb3_wrappers", 'pip install -e ".[train]"'),
        (
            "pygame", "import gymnasium, jackbox_env; gymnasium.make('JackInBox-v0', render_mode='rgb_array')",
            "drawing needs pygame, the extra 'render': in a checkout of jackbox, pip install -e \".[render]\"",
        ),
        ("pygame", "from jackbox_env import JackInBoxVectorEnv; JackInBoxVectorEnv(2).tiled()", 'e ".[render]"'),
        ("pygame", "from jackbox_env.playing_window import Window; Window(None)", 'pip install -e ".[render]"'),
        ("tyro", "import scripts.train", "this command needs tyro, the extra 'train': in a checkout of jackbox, pip"),
        ("tyro", "import scripts.evaluate", 'pip install -e ".[train]"'),
        ("pygame", "import scripts.play; sys.argv[1:] = []; scripts.play.main()", 'pip install -e ".[render]"'),
    ],
)  # fmt: skip
def test_a_missing_extra_says_how_to_get_it_from_a_checkout(missing: str, line: str, sentence: str) -> None:
    code = f"import sys; sys.modules[{missing!r}] = None\n{line}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode in (1, 2)
    assert sentence in done.stderr.strip().splitlines()[-1]
    assert done.stderr.strip().splitlines()[-1].count("pip install") == 1
