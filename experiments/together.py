"""PPO whose environments run in several processes:

    torchrun --standalone --nproc-per-node 2 experiments/together.py --num-envs 16

trains one agent like ppo_continuous.py, with eight environments in each of two processes.
"""

import os
import sys
import tempfile
from pathlib import Path

import torch
from torch import distributed

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import ppo_continuous as ppo

make_envs, play = ppo.make_envs, ppo.rollout


def share_of_envs(args, count, autoreset_mode="NextStep", **kwargs):
    """Those that train are divided among the processes."""
    if autoreset_mode == "Disabled":
        count //= distributed.get_world_size()
    return make_envs(args, count, autoreset_mode, **kwargs)


def rollout(envs, agent, *rest):
    """The agent of process 0 plays in every process; each gets the transitions of all."""
    for tensor in agent.state_dict().values():
        distributed.broadcast(tensor, src=0)
    batch, obs, earned, returns = play(envs, agent, *rest)
    parts = [None] * distributed.get_world_size()
    distributed.all_gather_object(parts, (batch, returns))
    columns = zip(*[batch for batch, _ in parts])
    batch = ppo.Transitions(*[torch.cat(column, dim=1) for column in columns])
    return batch, obs, earned, sum([returns for _, returns in parts], [])


def play_along(args):
    """Train like process 0, but leave updates and evaluations to it, and keep no file."""
    args.seed = [args.seed[0], args.seed[0] + 10**6 * distributed.get_rank()]
    ppo.optimise = lambda *_, **_options: {}
    ppo.evaluate = lambda *_: 0.0
    with tempfile.TemporaryDirectory() as folder:
        ppo.train(1, args, folder)  # the second seed: other noise and episodes, and no bar


def main():
    args = ppo.parse_args()
    if len(args.seed) > 1 or args.num_envs % int(os.environ["WORLD_SIZE"]):
        sys.exit("one --seed, and as many --num-envs for each process")
    distributed.init_process_group("gloo")
    ppo.make_envs, ppo.rollout = share_of_envs, rollout
    if distributed.get_rank() == 0:
        ppo.main()
    else:
        play_along(args)
    distributed.destroy_process_group()


if __name__ == "__main__":
    main()
