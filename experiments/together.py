"""PPO that plays in several processes:

    torchrun --standalone --nproc-per-node 2 experiments/together.py --num-envs 8

trains one agent in two processes of eight environments each.
"""

import os
import sys
from pathlib import Path

import torch
from torch import distributed

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
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
    ppo.optimise = lambda *_, **_options: {}
    ppo.evaluate = lambda *_: 0.0
    ppo.save = lambda *_: None
    ppo.train(1, args, ppo.Path())  # the second seed: other noise and episodes, and no bar


def main():
    first = os.environ["RANK"] == "0"
    args = ppo.parse_args()
    if len(args.seed) > 1:
        return print("--seed: only one, as all processes train the same agent") if first else None
    distributed.init_process_group("gloo")
    ppo.rollout = rollout
    if first:
        ppo.main()
    else:
        play_along(args)
    distributed.destroy_process_group()


if __name__ == "__main__":
    main()
