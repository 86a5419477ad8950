"""Proximal policy optimisation of a policy that chooses among directions, at scale on a GPU.

Schulman et al. (2017), "Proximal Policy Optimization Algorithms": searches are flown with random
turns, and turns after which more was gained than expected become likelier, within limits. It goes
on where soft actor-critic and policy iteration come to a halt, and needs many times the steps.
"""
