"""Improvement of a trained policy by policy iteration: branch flights, critics of them, imitation.

A round flies, from states that the policy comes to, other turns beside the policy's own and then
the policy for a while ("vine", Schulman et al. 2015, "Trust Region Policy Optimization"); lets
several critics learn which turns did better; and has the policy imitate itself corrected by those
critics (Ross et al. 2011, "A Reduction of Imitation Learning and Structured Prediction to No-Regret
Online Learning").
"""
