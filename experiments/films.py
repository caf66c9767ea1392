"""The films of the README: an agent before and after its training.

    python experiments/films.py reinforce_mujoco.py runs/…/seed-1.pt
    python experiments/films.py a2c_vector.py runs/…/seed-1.pt
    python experiments/films.py ppo_continuous.py runs/…/seed-1.pt

The last one takes an agent of the double pendulum or, for docs/cheetah.gif, of HalfCheetah-v5.
"""

import os
import sys

import gymnasium as gym
import matplotlib.font_manager
import mujoco
import numpy as np
import study
import torch
from PIL import Image, ImageDraw, ImageFont

os.environ.setdefault("MUJOCO_GL", "egl" if sys.platform == "linux" else "glfw")
WIDTH, HEIGHT, BAR, SKY = 480, 320, 40, (222, 235, 247)
FONT = ImageFont.truetype(matplotlib.font_manager.findfont("DejaVu Sans"), 26)


def camera(distance, height):
    look = {"distance": distance, "lookat": np.array([0, 0, height]), "elevation": -5}
    return {"width": WIDTH, "height": HEIGHT, "default_camera_config": look}


FILMS = {  # task: film, steps for a frame, milliseconds, camera, scenes: steps and words
    "InvertedPendulum-v5": ("reinforce_mujoco", 2, 80, camera(2.2, 0.15), [
        (40, "before: the pole falls"), (120, "after: pushed, the pole stands")]),
    "LunarLander-v3": ("a2c_vector", 4, 80, {}, [
        (104, "before: it crashes"), (290, "after a million steps: it lands")]),
    "InvertedDoublePendulum-v5": ("ppo_continuous", 1, 50, camera(3.0, 0.4), [
        (16, "before: it falls"), (70, "after: pushed, it stands")]),
    "HalfCheetah-v5": ("cheetah", 1, 50, {
        "width": WIDTH, "height": HEIGHT, "camera_name": "track"}, [
        (30, "before: {} m/s"), (70, "after a million steps: {} m/s")]),
}


def frame(image, words):
    """With a sky in place of the dark, and a line of text below."""
    image = np.array(image)
    image[(image < 12).all(-1)] = SKY
    page = Image.new("RGB", (WIDTH, HEIGHT + BAR), "white")
    page.paste(Image.fromarray(image).resize((WIDTH, HEIGHT)))
    ImageDraw.Draw(page).text((10, HEIGHT + 2), words, fill="black", font=FONT)
    return page


def mark(env, positions, **looks):
    """Shapes in the next frame, which have no part in the physics."""
    env.render()  # makes the viewer
    for position in positions:
        env.mujoco_renderer.viewer.add_marker(pos=np.array(position, float), **looks)


def decorate(env, task, step, pushed):
    """Colours; posts every two metres behind the cheetah; an arrow where the pole was pushed."""
    if task == "HalfCheetah-v5":
        env.model.geom_rgba[1:] = (1.0, 0.5, 0.1, 1.0)
        first = 2 * round(env.data.qpos[0] / 2)
        mark(env, [(first + x, 1.5, 0.25) for x in range(-6, 7, 2)],
             type=mujoco.mjtGeom.mjGEOM_BOX, size=np.array([0.04, 0.04, 0.25]),
             rgba=np.array([0.1, 0.2, 0.6, 1.0]))
    if task == "InvertedDoublePendulum-v5":
        env.model.geom_rgba[0, 3] = 0.0  # no floor
        env.model.geom_rgba[-1] = (1.0, 0.5, 0.1, 1.0)  # the upper pole
    if pushed and step % 40 in range(5, 17):
        x = env.data.qpos[0] - 0.55 * pushed
        turn = [0, 0, pushed, 0, 1, 0, -pushed, 0, 0]  # from the z-axis to ± x
        mark(env, [(x, 0, 0.5)], type=mujoco.mjtGeom.mjGEOM_ARROW, mat=np.array(turn, float),
             size=np.array([0.03, 0.03, 0.4]), rgba=np.array([0.9, 0.2, 0.1, 1.0]))


def play(module, args, weights, steps, words):
    """The frames of one scene; an agent without weights is new, and draws its actions."""
    _, steps_a_frame, _, look, _ = FILMS[args.env_id]
    env = gym.make(args.env_id, render_mode="rgb_array", **look).unwrapped  # no time limit
    torch.manual_seed(1)
    agent = module.Agent(env.observation_space, env.action_space, args.hidden_size)
    if weights:
        agent.load_state_dict(weights)
    elif hasattr(agent, "sigma"):
        agent.sigma.fill_(args.first_std)
    frames, speed = [], 0.0
    obs, _ = env.reset(seed=3)
    for step in range(steps):
        pushed = (-1) ** (step // 40) if weights and "Pendulum" in args.env_id else 0
        if step % steps_a_frame == 0:
            decorate(env, args.env_id, step, pushed)
            frames.append(frame(env.render(), words.format(round(speed))))
        if hasattr(agent, "act"):
            action = agent.act(np.array(obs, float)[None], deterministic=bool(weights))[0]
        else:  # REINFORCE's
            policy = agent.policy(torch.tensor(obs, dtype=torch.float32))
            action = (policy.mean if weights else policy.sample()).detach().numpy()
        if hasattr(module, "squash"):
            action = module.squash(action, env.action_space)
        elif args.env_id == "InvertedPendulum-v5":
            action = action.clip(env.action_space.low, env.action_space.high)
        if pushed and step % 40 == 5:
            radians_a_second = 0.3 if "Double" in args.env_id else 1.5
            env.data.qvel[1] += pushed * radians_a_second
        obs, _, _, _, info = env.step(action)
        speed += 0.2 * (info.get("x_velocity", 0) - speed)  # the mean of some five steps
    env.close()
    return frames


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python experiments/films.py SCRIPT AGENT.pt")
    script, path = sys.argv[1:]
    saved = torch.load(path, weights_only=True)
    module, args = study.load(study.Job(script, f"--env-id {saved['options']['env_id']}"))
    name, _, milliseconds, _, scenes = FILMS[args.env_id]
    before, after = (play(module, args, weights, *scene)
                     for weights, scene in zip((None, saved["agent"]), scenes))
    samples = np.hstack([np.array(x) for x in (before + after)[:: len(after) // 9]])
    palette = Image.fromarray(samples).quantize(64, Image.Quantize.MAXCOVERAGE)
    frames = [x.quantize(palette=palette, dither=Image.Dither.NONE) for x in before + after]
    durations = np.full(len(frames), milliseconds)
    durations[[len(before) - 1, -1]] = 1000  # hold the end
    frames[0].save(study.ROOT / f"docs/{name}.gif", save_all=True, loop=0,
                   append_images=frames[1:], duration=durations.tolist(), optimize=True)
