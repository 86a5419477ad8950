"""The learned policy: what it observes, its network, the trained model's file.

Array code here runs on NumPy for planning and on PyTorch for training, on the CPU and on a GPU:
functions take the library of the arrays they are given.
"""
