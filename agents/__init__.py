"""Agents for JackInBox-v0: scripted policies, PPO training, evaluation, film. Used from a checkout, not shipped.

A policy has Stable-Baselines3's ``predict``, and keywords of ``gymnasium.make`` for its environment. A function of
observations, shape (n, numbers), is one too; ``jackbox evaluate --policy file.py:function --env name=value`` plays it:

>>> from agents.evaluation.returns import evaluate
>>> from agents.policies.scripted import PolicyWithEnv, StatelessPolicy
>>> level = StatelessPolicy(lambda seen: -5.0 * seen[:, 5] - 5.0 * seen[:, 6])  # sine of the box's angle, and its rate
>>> returns = evaluate("mine", PolicyWithEnv(level, {"action_repeat": 2}), {"fidelity": "exact"}, episodes=64, seed=0)
>>> low, high = returns.interval  # 95 %, of the mean
>>> 150.0 < low < returns.mean < high < 300.0
True
"""
