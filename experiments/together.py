"""PPO that plays in several processes: torchrun --standalone --nproc-per-node 2 together.py"""

import torch
from torch import distributed

import ppo_continuous as ppo

play = ppo.rollout


def rollout(envs, agent, obs, num_steps):
    """The agent of process 0 plays in every process; each gets the transitions of all."""
    for tensor in agent.state_dict().values():
        distributed.broadcast(tensor, src=0)
    batch, obs, returns = play(envs, agent, obs, num_steps)
    parts = [None] * distributed.get_world_size()
    distributed.all_gather_object(parts, (batch, returns))
    columns = zip(*[batch for batch, _ in parts])
    batch = ppo.Transitions(*[torch.cat(column, dim=1) for column in columns])
    return batch, obs, sum([returns for _, returns in parts], [])


def play_along(args):
    """Train like process 0, but leave updates, evaluations and files to it."""
    args.seed = [args.seed[0], args.seed[0] + 10**6 * distributed.get_rank()]
    ppo.optimise = lambda *_: {}
    ppo.evaluate = lambda *_: 0.0
    ppo.save = lambda *_: None
    ppo.train(1, args, ppo.Path())  # the second seed: other noise and episodes, and no bar


if __name__ == "__main__":
    distributed.init_process_group("gloo")
    ppo.rollout = rollout
    if distributed.get_rank() == 0:
        ppo.main()
    else:
        play_along(ppo.parse_args())
    distributed.destroy_process_group()
