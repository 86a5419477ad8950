"""Expert iteration: a policy learns from search what it did not find by itself.

From states that the policy comes to, annealing finds better ways on; the policy learns to turn as
they do, flies anew, and search goes on from there (Anthony et al. 2017, "Thinking Fast and Slow
with Deep Learning and Tree Search").
"""
