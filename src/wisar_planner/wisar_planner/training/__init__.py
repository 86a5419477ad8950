"""Training of the policy: random worlds, the batched environment, soft actor-critic, runs.

Needs PyTorch, which planning does not: `make train` installs it.
"""
