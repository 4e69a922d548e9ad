"""A small network for mean and standard deviation of normal targets, fitted by maximum likelihood."""

from __future__ import annotations

import numpy as np

from probe_env.arrays import FloatArray

HIDDEN = 64


def fit_network(
    x: FloatArray, y: FloatArray, seed: int, epochs: int, batch: int, clamp: tuple[float, float]
) -> list[tuple[FloatArray, FloatArray]]:
    """Weights (in, out) and biases (out,) of three layers, tanh between them, for scaled inputs (n, d), targets (n, t).

    The outputs are t means and t logarithms of standard deviations, clamped to ``clamp`` in the loss.
    """
    import torch

    torch.manual_seed(seed)
    inputs, targets = (torch.tensor(values, dtype=torch.float32) for values in (x, y))
    network = torch.nn.Sequential(
        torch.nn.Linear(inputs.shape[1], HIDDEN), torch.nn.Tanh(),
        torch.nn.Linear(HIDDEN, HIDDEN), torch.nn.Tanh(),
        torch.nn.Linear(HIDDEN, 2 * targets.shape[1]),
    )  # fmt: skip
    steps = epochs * max(len(inputs) // batch, 1)
    optimiser = torch.optim.AdamW(network.parameters(), lr=3e-3, weight_decay=1e-3)
    pace = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        chosen = torch.randint(len(inputs), (batch,))
        mean, spread = network(inputs[chosen]).chunk(2, dim=1)
        loss = torch.nn.functional.gaussian_nll_loss(mean, targets[chosen], torch.exp(2.0 * spread.clamp(*clamp)))
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        pace.step()
    parts = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
    return [(p.weight.detach().numpy().T.astype(np.float32).copy(), p.bias.detach().numpy().copy()) for p in parts]
