"""The paper's own environment and policy network, to train beside ours.

Ewers, Anderson and Thomson (2024), "Deep reinforcement learning for time-critical wilderness search
and rescue using drones". What the paper leaves open is decided here and said where it is.
"""
