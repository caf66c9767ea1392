"""stable-baselines3, with its defaults and with the settings of its zoo.

CleanRL's ppo_continuous_action is no peer here: it cannot be installed with these versions.
"""

import torch
from benchmark.common import A2C, PPO

# rl-baselines3-zoo, hyperparams/ppo.yml and a2c.yml; a learning rate (x,) falls linearly to 0.
TANH_RELU = {"log_std_init": -2, "ortho_init": False, "activation_fn": torch.nn.ReLU,
             "net_arch": {"pi": [256, 256], "vf": [256, 256]}}
ZOO = {
    (PPO, "HalfCheetah-v5"): {
        "num_envs": 1, "batch_size": 64, "n_steps": 512, "gamma": 0.98, "learning_rate": 2.0633e-05,
        "ent_coef": 0.000401762, "clip_range": 0.1, "n_epochs": 20, "gae_lambda": 0.92,
        "max_grad_norm": 0.8, "vf_coef": 0.58096, "policy_kwargs": TANH_RELU},
    (PPO, "Hopper-v5"): {
        "num_envs": 1, "batch_size": 32, "n_steps": 512, "gamma": 0.999,
        "learning_rate": 9.80828e-05, "ent_coef": 0.00229519, "clip_range": 0.2, "n_epochs": 5,
        "gae_lambda": 0.99, "max_grad_norm": 0.7, "vf_coef": 0.835671, "policy_kwargs": TANH_RELU},
    (PPO, "Walker2d-v5"): {
        "num_envs": 1, "batch_size": 32, "n_steps": 512, "gamma": 0.99,
        "learning_rate": 5.05041e-05, "ent_coef": 0.000585045, "clip_range": 0.1, "n_epochs": 20,
        "gae_lambda": 0.95, "max_grad_norm": 1, "vf_coef": 0.871923},
    (A2C, "LunarLander-v3"): {
        "num_envs": 8, "gamma": 0.995, "n_steps": 5, "ent_coef": 1e-5, "learning_rate": (8.3e-4,)},
}


def make(script, env_id, num_envs, seed, **settings):
    """A model that has not learned yet. Environments do not draw: LunarLander would make sparks."""
    import stable_baselines3 as sb3
    from stable_baselines3.common import env_util, vec_env

    torch.set_num_threads(1)  # as ours
    envs = env_util.make_vec_env(env_id, num_envs, seed, env_kwargs={"render_mode": None})
    if script == PPO:
        envs = vec_env.VecNormalize(envs, gamma=settings.get("gamma", 0.99))
    rate = settings.pop("learning_rate", None)
    if isinstance(rate, tuple):
        settings["learning_rate"] = lambda left: rate[0] * left
    elif rate:
        settings["learning_rate"] = rate
    algorithm = sb3.PPO if script == PPO else sb3.A2C
    return algorithm("MlpPolicy", envs, seed=seed, device="cpu", **settings)


class Agent:
    """Looks like one of ours."""

    def __init__(self, model):
        self.model = model

    def act(self, obs, deterministic):
        envs = self.model.get_vec_normalize_env()
        seen = envs.normalize_obs(obs) if envs else obs
        return self.model.predict(seen, deterministic=deterministic)[0]


def learn(script, args, seed, zoo, visit):
    """Train, and call visit(env_step, agent) after each step of the environments."""
    settings = dict(ZOO[script, args.env_id]) if zoo else {"num_envs": 8 if script == A2C else 1}
    model = make(script, args.env_id, settings.pop("num_envs"), seed, **settings)
    agent = Agent(model)

    def after_step(*_):
        visit(model.num_timesteps, agent)
        return True

    model.learn(args.total_steps, callback=after_step)
    visit(model.num_timesteps, agent, last=True)  # after the last update
