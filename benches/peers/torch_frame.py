"""One frame of FNOpt in PyTorch: what a user of that library would write and run.

The energy is written as in the specification and differentiated by autograd; the network uses PyTorch's own
transforms and matrix products. Lengths are in edges, times in frames, as inside fnopt. `compare.py` runs this
alongside fnopt; run alone, it prints one JSON line with the median time of a frame.
"""

import argparse
import json
import statistics
import time

import numpy
import torch
from safetensors.torch import load_file

SCALE_OF_A_FRESH_CLOTH = 0.05


class Network:
    """The Fourier neural operator: maps three fields of one component to a field and a scalar."""

    def __init__(self, path, device):
        stored = load_file(path)
        part = lambda name: stored["nn." + name].to(device)
        matrix = lambda name: part(name).flatten(1)
        self.lift = [(matrix(f"lifting.fcs.{k}.weight"), part(f"lifting.fcs.{k}.bias")) for k in (0, 1)]
        self.project = [(matrix(f"projection.fcs.{k}.weight"), part(f"projection.fcs.{k}.bias")) for k in (0, 1)]
        self.head = part("out_scalar.weight"), part("out_scalar.bias")
        self.blocks = []
        biases = part("fno_blocks.convs.bias")
        for k in range(4):
            real, imaginary = part(f"fno_blocks.convs.weight.{k}.tensor").unbind(-1)
            modes = torch.complex(real, imaginary)
            self.blocks.append((modes, biases[k].reshape(-1, 1, 1), matrix(f"fno_blocks.fno_skips.{k}.conv.weight")))

    def __call__(self, fields):
        samples, _, h, w = fields.shape
        down = torch.linspace(0, 1, h, device=fields.device).reshape(1, 1, h, 1).expand(samples, 1, h, w)
        across = torch.linspace(0, 1, w, device=fields.device).reshape(1, 1, 1, w).expand(samples, 1, h, w)
        x = layers(self.lift, torch.cat([fields, down, across], 1))
        for k, (modes, bias, skip) in enumerate(self.blocks):
            x = spectral(x, modes) + bias + product(skip, x)
            if k < 3:
                x = torch.nn.functional.gelu(x)
            if k == 2:
                number = torch.nn.functional.linear(x.amax((2, 3)), *self.head)
        return layers(self.project, x), number


def product(matrix, x):
    return torch.einsum("oi,sihw->sohw", matrix, x)


def layers(two, x):
    (first, bias), (second, last) = two
    x = torch.nn.functional.gelu(product(first, x) + bias.reshape(-1, 1, 1))
    return product(second, x) + last.reshape(-1, 1, 1)


def spectral(x, modes):
    """Multiplies the lowest modes, rows -4 to 3, by a complex matrix each, `modes` [I, O, 8, 5]; drops the
    others."""
    h, w = x.shape[2:]
    rows, columns = modes.shape[2:]
    half = rows // 2
    z = torch.fft.rfft2(x, norm="forward")[..., :columns]
    low = torch.cat([z[:, :, h - half :], z[:, :, : rows - half]], 2)
    low = torch.einsum("sikl,iokl->sokl", low, modes)
    out = x.new_zeros((x.shape[0], modes.shape[1], h, w // 2 + 1), dtype=z.dtype)
    out[:, :, h - half :, :columns] = low[:, :, :half]
    out[:, :, : rows - half, :columns] = low[:, :, half:]
    return torch.fft.irfft2(out, s=(h, w), norm="forward")


def angle(u, v):
    sine = torch.linalg.cross(u, v, dim=1).square().sum(1).clamp_min(1e-24).sqrt()
    return torch.atan2(sine, (u * v).sum(1))


class Cloth:
    """Copies of one sheet, with some particles held, without air."""

    def __init__(self, start, held, gravity, material, device):
        h, w = start.shape[2:]
        self.x, self.v = start.to(device), torch.zeros_like(start, device=device)
        self.target = self.x.clone()
        self.free = torch.ones(1, 1, h, w, device=device)
        for i, j in held:
            self.free[..., i, j] = 0
        self.mass = torch.ones(h, w, device=device)
        for border in (self.mass[0], self.mass[-1], self.mass[:, 0], self.mass[:, -1]):
            border *= 0.5
        self.force = torch.tensor(gravity, device=device).reshape(1, 3, 1, 1)
        self.material = material
        samples = 3 * start.shape[0]
        self.hidden = (
            torch.zeros(samples, 1, h, w, device=device),
            torch.zeros(samples, 1, h, w, device=device),
            torch.full((samples, 1, 1, 1), SCALE_OF_A_FRESH_CLOTH, device=device),
        )

    def place(self, a):
        return self.target + self.free * (self.x + self.v + a - self.target)

    def energy(self, a):
        stretch, shear, bend = self.material
        x = self.place(a)
        down, across = x.diff(dim=2), x.diff(dim=3)
        longer = lambda edge: (edge.square().sum(1).sqrt() - 1).square().mean((1, 2))
        total = stretch * (longer(down) + longer(across))
        per_particle = 1 / (x.shape[2] * x.shape[3])
        corners = 0
        for u in (down[..., :-1], down[..., 1:]):
            for v in (across[:, :, :-1], across[:, :, 1:]):
                corners = corners + (angle(u, v) - torch.pi / 2).square().sum((1, 2))
        folds = angle(down[:, :, 1:], down[:, :, :-1]).square().sum((1, 2))
        folds = folds + angle(across[..., 1:], across[..., :-1]).square().sum((1, 2))
        total = total + per_particle * (shear * corners + bend * folds)
        work = self.mass * (0.5 * a - self.force) * a
        return (total + work.sum(1).mean((1, 2))).sum()

    def frame(self, network, iterations):
        a = torch.zeros_like(self.x)
        for _ in range(iterations):
            a.requires_grad_(True)
            (grad,) = torch.autograd.grad(self.energy(a), a)
            with torch.no_grad():
                a = a + self.step(network, grad)
        with torch.no_grad():
            moved = self.place(a)
            self.v = moved - self.x
            self.x = moved

    def step(self, network, grad):
        grad = grad.reshape(self.hidden[0].shape)
        last, step, scale = self.hidden
        size = lambda field: field.square().mean((1, 2, 3), keepdim=True).sqrt().clamp_min(1e-30)
        of_gradient, of_step = size(grad), size(step)
        inputs = [grad / of_gradient, last / of_gradient, step / of_step]
        field, number = network(torch.cat([10 * torch.tanh(f / 10) for f in inputs], 1))
        scale = scale * torch.exp(2 * torch.tanh(number / 2) - 1).reshape(scale.shape)
        step = scale * torch.tanh(field)
        self.hidden = grad, step, scale
        return step.reshape(self.x.shape)


def captured(cloth, network, iterations):
    """Returns the frame as a CUDA graph; its inputs and outputs keep their addresses."""
    state = [cloth.x, cloth.v, *cloth.hidden]
    begun = [tensor.clone() for tensor in state]


    def put(values):
        cloth.x, cloth.v, cloth.hidden = values[0], values[1], tuple(values[2:])

    aside = torch.cuda.Stream()
    aside.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(aside):
        for _ in range(3):
            put(state)
            cloth.frame(network, iterations)
    torch.cuda.current_stream().wait_stream(aside)
    graph = torch.cuda.CUDAGraph()
    put(state)
    with torch.cuda.graph(graph):
        cloth.frame(network, iterations)
        for tensor, new in zip(state, [cloth.x, cloth.v, *cloth.hidden]):
            tensor.copy_(new)
    put(state)
    for tensor, old in zip(state, begun):
        tensor.copy_(old)
    return graph.replay


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", required=True, help="weights, a safetensors file")
    parser.add_argument("--start", required=True, help="positions [H, W, 3] in edges, .npy")
    parser.add_argument("--held", type=int, nargs="+", required=True, help="held particles, numbered i W + j")
    parser.add_argument("--gravity", type=float, nargs=3, required=True, help="edges / frame^2")
    parser.add_argument("--material", type=float, nargs=3, default=(1000.0, 8.0, 0.5))
    parser.add_argument("--batch", type=int, default=1)
    parser.add_argument("--iterations", type=int, default=10)
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--mode", choices=["eager", "compiled", "graph"], default="eager")
    parser.add_argument("--tf32", action="store_true")
    parser.add_argument("--out", help="positions of the first cloth after each frame [F, H, W, 3], .npy")
    options = parser.parse_args()

    torch.set_num_threads(options.threads)
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = options.tf32
    device = torch.device(options.device)
    network = Network(options.checkpoint, device)
    if options.mode == "compiled":
        network = torch.compile(network.__call__)
    start = torch.from_numpy(numpy.load(options.start)).float().permute(2, 0, 1)
    width = start.shape[2]
    held = [divmod(particle, width) for particle in options.held]
    start = start[None].repeat(options.batch, 1, 1, 1)
    cloth = Cloth(start, held, options.gravity, options.material, device)
    frame = lambda: cloth.frame(network, options.iterations)
    if options.mode == "graph":
        frame = captured(cloth, network, options.iterations)
    wait = torch.cuda.synchronize if device.type == "cuda" else lambda: None

    times, kept = [], []
    for _ in range(3 + options.frames):
        wait()
        begun = time.perf_counter()
        frame()
        wait()
        times.append(1e3 * (time.perf_counter() - begun))
        kept.append(cloth.x[0].permute(1, 2, 0).cpu().numpy().copy() if options.out else None)
    if options.out:
        numpy.save(options.out, numpy.stack(kept))
    print(json.dumps({"ms_per_frame": statistics.median(times[3:]), "torch": torch.__version__}))


if __name__ == "__main__":
    main()
