"""Muon: training by steps of the same size in every direction."""

import torch

MOMENTUM = 0.95
# of a Newton-Schulz iteration: singular values go to .7 .. 1.2
POLYNOMIAL = 3.4445, -4.7750, 2.0315
ITERATIONS = 5
SIZE = 0.2  # root mean square of a step whose rate is 1, about Adam's


class Muon(torch.optim.Optimizer):
    """Steps along the momentum of each weight, whose singular values are first made equal.

    PyTorch's own takes matrices only, and cannot be recorded in a CUDA graph.

    Args:
        params: Weights of convolutions. Each is a matrix, a row for each output.
        rate: Of learning: a tensor that may change between steps.

    Source:
        Jordan et al. 2024, "Muon: an optimizer for hidden layers in neural networks"; the size of
        a step: Liu et al. 2025, "Muon is scalable for LLM training", arXiv 2502.16982.
    """

    def __init__(self, params, rate: torch.Tensor):
        super().__init__(params, {"lr": rate})

    @torch.no_grad()
    def step(self, closure=None) -> None:
        """Change the weights."""
        for group in self.param_groups:
            for param in group["params"]:
                if "momentum" not in self.state[param]:
                    self.state[param]["momentum"] = torch.zeros_like(param)
            momenta = [self.state[param]["momentum"] for param in group["params"]]
            grads = [param.grad for param in group["params"]]
            torch._foreach_lerp_(momenta, grads, 1 - MOMENTUM)
            ahead = torch._foreach_lerp(grads, momenta, MOMENTUM)  # Nesterov's
            for shape in {param.shape for param in group["params"]}:  # together: fewer kernels
                alike = [i for i, param in enumerate(group["params"]) if param.shape == shape]
                steps = _equalise(torch.stack([ahead[i].flatten(1) for i in alike]))
                length = SIZE * max(steps.shape[1:]) ** 0.5
                for i, one in zip(alike, steps, strict=True):
                    group["params"][i].sub_(one.reshape(shape) * (length * group["lr"]))


def _equalise(matrices):
    """Return matrices (N, rows, cols) with the same singular vectors and singular values near 1."""
    a, b, c = POLYNOMIAL
    matrices = matrices / (matrices.norm(dim=(1, 2), keepdim=True) + 1e-7)
    for _ in range(ITERATIONS):
        square = matrices @ matrices.mT
        matrices = a * matrices + (b * square + c * square @ square) @ matrices
    return matrices
