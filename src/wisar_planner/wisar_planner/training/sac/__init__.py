"""Soft actor-critic: fly, remember, learn from what is remembered.

Haarnoja et al. (2018), "Soft Actor-Critic Algorithms and Applications". Here a policy begins.
"""
