"""RandomPhysics of a2c_vector.py: what it draws, when, and that it changes nothing else."""

import functools
import multiprocessing

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from conftest import SCRIPTS

import a2c_vector as a2c

LANDER = "LunarLander-v3"
NAMES = "gravity", "wind_power", "turbulence_power"


def random_lander():
    return a2c.RandomPhysics(gym.make(LANDER))


def physics_in_force(env):
    env = env.unwrapped
    assert env.world.gravity[1] == pytest.approx(env.gravity)
    return {name: getattr(env, name) for name in ("enable_wind", *NAMES)}


@functools.cache
def usual_physics():
    env = gym.make(LANDER)
    env.reset()
    return physics_in_force(env)


def draw_physics(vectorization):
    """What two environments draw for two episodes, for the seeds 1, 2 and 1 again."""
    envs = a2c.make_envs(LANDER, 2, "Disabled", vectorization, randomize=True)
    drawn = []
    for seed in 1, 2, 1:
        for env_seeds in a2c.make_seeds(seed, stream=2, count=2), None:
            envs.reset(seed=env_seeds)
            drawn.append([list(x) for x in zip(*map(envs.unwrapped.get_attr, NAMES))])
    envs.close()
    return drawn


def test_physics_fill_their_ranges():
    env, drawn = random_lander(), []
    for episode in range(300):
        env.reset(seed=None if episode else 0)
        drawn.append(physics_in_force(env))
    drawn = pd.DataFrame(drawn)
    for name, low, high in zip(NAMES, (-11.99, 0, 0), (-7, 20, 2)):
        margin = 0.05 * (high - low)
        assert low <= drawn[name].min() < low + margin
        assert high >= drawn[name].max() > high - margin
        assert drawn[name].nunique() == 300
    assert 0.4 < drawn["enable_wind"].mean() < 0.6
    assert drawn.astype(float).corr().abs().sum().max() < 1.5  # drawn one by one


def test_physics_have_nothing_to_do_with_the_ground():
    env, drawn = random_lander(), []
    for seed in range(200):
        env.reset(seed=seed)
        ground = [corners[0][1] for corners in env.unwrapped.sky_polys]
        drawn.append([*physics_in_force(env).values(), ground[0], ground[2]])
    correlations = np.corrcoef(np.transpose(drawn))[:4, 4:]
    assert np.abs(correlations).max() < 0.25


def test_physics_do_not_change_what_else_an_environment_draws():
    """A lander that is given the same physics by hand shows the same, episode after episode."""
    env, other = random_lander(), gym.make(LANDER)
    winds = set()
    for seed in 3, None, None, 4, None, None:
        obs, _ = env.reset(seed=seed)
        for name, value in physics_in_force(env).items():
            setattr(other.unwrapped, name, value)
        winds.add(env.unwrapped.enable_wind)
        np.testing.assert_array_equal(obs, other.reset(seed=seed)[0])
        for t in range(40):
            one, two = env.step(t % 4), other.step(t % 4)
            np.testing.assert_array_equal(one[0], two[0])
            assert one[1:] == two[1:]
    assert winds == {True, False}


def test_physics_differ_between_environments_episodes_and_seeds_and_repeat_with_the_seed():
    first, second, other_first, other_second, again, again_second = draw_physics("sync")
    assert [first, second] == [again, again_second]
    drawn = [values for episode in (first, second, other_first, other_second) for values in episode]
    assert len(drawn) == 8
    for values in zip(*drawn):  # gravity, wind power, turbulence
        assert len(set(values)) == 8


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")  # of Python 3.12
@pytest.mark.parametrize("method", [
    "fork", *(pytest.param(x, marks=pytest.mark.slow) for x in ("spawn", "forkserver"))])
def test_several_processes_draw_what_a_single_one_would(method):
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {method} here")
    usual = multiprocessing.get_start_method(allow_none=True)
    multiprocessing.set_start_method(method, force=True)
    try:
        drawn = draw_physics("async")
    finally:
        multiprocessing.set_start_method(usual, force=True)
    assert drawn == draw_physics("sync")


@pytest.mark.parametrize("randomize", [True, False])
def test_only_training_with_randomize_leaves_the_usual_physics(randomize, tmp_path, monkeypatch):
    """Evaluations and a training without it keep to the physics that are registered."""
    seen = {"rollout": [], "evaluate": []}

    def watch(name, function):
        def watched(*args):
            result = function(*args)
            (envs,) = (x for x in args if isinstance(x, gym.vector.VectorEnv))
            seen[name] += map(physics_in_force, envs.unwrapped.envs)
            return result

        return watched

    for name in seen:
        monkeypatch.setattr(a2c, name, watch(name, getattr(a2c, name)))
    SCRIPTS["a2c_vector"].train(tmp_path, *["--randomize"] * randomize, env_id=LANDER)
    assert len(seen["rollout"]) == 4 * 4
    assert all((physics == usual_physics()) != randomize for physics in seen["rollout"])
    assert seen["evaluate"] == [usual_physics()] * 5 * 2
