"""PPO that plays in several processes: torchrun --standalone --nproc-per-node 2 together.py"""

import tempfile

import torch
from torch import distributed

import ppo_continuous as ppo

play = ppo.rollout


def rollout(envs, agent, obs, args, env_step):
    """The agent of process 0 plays in every process; each gets the transitions of all."""
    for tensor in agent.state_dict().values():
        distributed.broadcast(tensor, src=0)
    batch, obs, episodes = play(envs, agent, obs, args, env_step)
    parts = [None] * distributed.get_world_size()
    distributed.all_gather_object(parts, (vars(batch), episodes))
    for name in vars(batch):
        setattr(batch, name, torch.cat([columns[name] for columns, _ in parts], dim=1))
    episodes = [row for _, rows in parts for row in rows]
    for row in episodes:  # it has counted the steps of its own process
        row["env_step"] = env_step + (row["env_step"] - env_step) * len(parts)
    return batch, obs, episodes


def play_along(args):
    """Run like process 0, but leave updates, evaluations and files to it."""
    args.seed = [args.seed[0], args.seed[0] + 10**6 * distributed.get_rank()]
    ppo.optimise = lambda *_: None
    ppo.evaluate = lambda *_: {"return_mean": 0.0}
    ppo.save = lambda *_: None
    with tempfile.TemporaryDirectory() as folder:
        ppo.run(1, args, ppo.Path(folder))  # the second seed: other noise and episodes, and no bar


if __name__ == "__main__":
    distributed.init_process_group("gloo")
    ppo.rollout = rollout
    if distributed.get_rank() == 0:
        ppo.main()
    else:
        play_along(ppo.parse_args())
    distributed.destroy_process_group()
