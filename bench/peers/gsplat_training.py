"""Training with gsplat 1.5.3 on the photographs, masks, cameras, first Gaussians and test split of `vrgs.py train`.

    pip install -r bench/peers/requirements-gsplat.txt
    python -m bench.peers.gsplat_training CAPTURE... [--steps 30000] [--at 7000 30000] [--json OUT.json]
        [--strategy default|absgrad|mcmc] [--cap N]

Its strategies: `default`; `absgrad`, the same with absolute gradients and the threshold of 8e-4 that it names for them;
`mcmc` with at most `--cap` Gaussians, which start with a tenth of the size and an opacity of 0.5, and whose opacities
and scales cost 0.01 each. In trainings of other lengths than 30,000 steps the last Gaussians are added earlier or later
in proportion. The values are those of its examples/simple_trainer.py: packed=False, fused Adam, learning rates 1.6e-4
times the scene's scale (decaying to a hundredth), 5e-3, 5e-2, 1e-3, 2.5e-3, 2.5e-3 / 20, one more degree of the
harmonics each 1000 steps, 0.8 L1 + 0.2 (1 - SSIM) with SSIM of the pixels whose window lies inside of the image. Pixels
that do not count are left out as ours does it: the photograph is taken for what is drawn there.

The example takes SSIM from fused-ssim, which is not on PyPI. Here it is plain convolutions with the gradient written by
hand, which is slower. Photographs lie on the GPU and nothing waits for the device, so that the example's data loader
and progress bar cost nothing. As shipped, 1.5.3 never resets opacities: `step % self.reset_every == 0 & step > 0` is
never true.
"""

import argparse
import math
import sys
import time
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from gsplat import DefaultStrategy, MCMCStrategy, rasterization

from assets.file_access import write_json
from assets.gaussians import Gaussians
from bench.training_speed import device_memory, print_rows, print_test, read_training_capture
from core.errors import BadInput
from prepare.train.seeds import first_gaussians

DEGREE, DEGREE_INTERVAL = 3, 1000
STEPS = 30_000  # of which its strategies know
RATES = {"means": 1.6e-4, "scales": 5e-3, "quats": 1e-3, "opacities": 5e-2, "sh0": 2.5e-3, "shN": 2.5e-3 / 20}
RADIUS, SIGMA = 5, 1.5  # [px] of SSIM's window
C1, C2 = 0.01**2, 0.03**2
STRATEGIES = ("default", "absgrad", "mcmc")
GROW_ABSGRAD = 8e-4
MCMC_SHRINK, MCMC_OPACITY, MCMC_COST = 0.1, 0.5, 0.01


class Similarity(torch.autograd.Function):
    """Sum over pixels of `weight` (1, 1, H, W) times the SSIM of x and y (1, 3, H, W), with zeros outside of them."""

    @staticmethod
    def forward(ctx, x, y, weight):
        mx, my, xx, yy, xy = blur(torch.cat([x, y, x * x, y * y, x * y], 1)).chunk(5, 1)
        a, b = 2 * mx * my + C1, 2 * (xy - mx * my) + C2
        c, d = mx * mx + my * my + C1, xx - mx * mx + yy - my * my + C2
        value = a * b / (c * d)
        by_square, by_product = -value / d, 2 * a / (c * d)
        by_mean = 2 * my * b / (c * d) - 2 * mx * value / c - 2 * mx * by_square - my * by_product
        slopes = torch.cat([weight * by_mean, weight * by_square, weight * by_product], 1)
        s_mean, s_square, s_product = blur(slopes).chunk(3, 1)
        ctx.save_for_backward(s_mean + 2 * x * s_square + y * s_product)
        return (weight * value).sum()

    @staticmethod
    def backward(ctx, upstream):
        (gradient,) = ctx.saved_tensors
        return upstream * gradient, None, None


def blur(image):
    """The image (1, C, H, W) under SSIM's window, zeros outside."""
    at = torch.arange(-RADIUS, RADIUS + 1, device=image.device, dtype=torch.float32)
    window = torch.exp(-0.5 * (at / SIGMA) ** 2)
    window = (window / window.sum()).expand(image.shape[1], 1, 1, -1)
    along = F.conv2d(image, window, padding=(0, RADIUS), groups=image.shape[1])
    return F.conv2d(along, window.transpose(2, 3), padding=(RADIUS, 0), groups=image.shape[1])


class Target:
    """A photograph on the device: its pixels, those that count, and its camera."""

    def __init__(self, photograph, device):
        c = photograph.camera
        self.width, self.height = c.width, c.height
        self.pixels = torch.from_numpy(np.ascontiguousarray(photograph.pixels)).to(device)
        self.mask = None if photograph.mask.all() else torch.from_numpy(photograph.mask).to(device)
        self.count = int(photograph.mask.sum())
        self.view = torch.tensor(c.world_to_camera, dtype=torch.float32, device=device)[None]
        self.K = torch.tensor([[[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]]], dtype=torch.float32, device=device)
        inside = torch.zeros(1, 1, c.height, c.width, device=device)
        inside[:, :, RADIUS:-RADIUS, RADIUS:-RADIUS] = 1.0
        if self.mask is not None:
            inside *= self.mask
        self.inside = inside / (3 * inside.sum().clamp_min(1))

    def pair(self, drawn):
        """The drawn picture (1, H, W, 3) and the photograph as (1, 3, H, W), equal where pixels do not count."""
        truth = self.pixels[None].float() / 255.0
        if self.mask is not None:
            drawn = torch.where(self.mask[None, ..., None], drawn, truth)
        return drawn.permute(0, 3, 1, 2), truth.permute(0, 3, 1, 2)

    def loss(self, drawn):
        """0.8 L1 + 0.2 (1 - SSIM)."""
        x, y = self.pair(drawn)
        l1 = (x - y).abs().sum() / (3 * self.count)
        return 0.8 * l1 + 0.2 * (1.0 - Similarity.apply(x, y, self.inside))

    @torch.no_grad()
    def quality(self, drawn) -> tuple[float, float]:
        """PSNR [dB] and SSIM over the pixels that count, as `vrgs.py train` computes them."""
        x, y = self.pair(drawn.clamp(0.0, 1.0))
        counts = torch.ones_like(x[:, :1]) if self.mask is None else self.mask[None, None].float()
        error = ((x - y) ** 2).sum() / (3 * self.count)
        similarity = Similarity.apply(x, y, counts / (3 * self.count))
        return float(-10.0 * torch.log10(error.clamp_min(1e-12))), float(similarity)


class Training:
    """gsplat's training of the first Gaussians `start` to `targets`."""

    def __init__(
        self, targets, start: Gaussians, scale: float, steps: int, *, strategy: str, cap: int, seed: int, device
    ):
        self.targets, self.device = targets, device
        self.mcmc, self.absgrad = strategy == "mcmc", strategy == "absgrad"
        self.rng, self.queue, self.done = np.random.default_rng(seed), [], 0
        torch.manual_seed(seed)
        values = {"means": start.means, "scales": start.log_scales, "quats": start.quats}
        values |= {"opacities": start.logit_opacities, "sh0": start.sh[:, :1], "shN": start.sh[:, 1:]}
        self.params = torch.nn.ParameterDict(
            {name: torch.nn.Parameter(torch.from_numpy(np.ascontiguousarray(v))) for name, v in values.items()}
        ).to(device)
        fused = device.type == "cuda"
        self.optimizers = {
            name: torch.optim.Adam(
                [{"params": self.params[name], "lr": rate * (scale if name == "means" else 1.0), "name": name}],
                eps=1e-15,
                betas=(0.9, 0.999),
                fused=fused,
            )
            for name, rate in RATES.items()
        }
        self.decay = torch.optim.lr_scheduler.ExponentialLR(self.optimizers["means"], gamma=0.01 ** (1.0 / steps))
        if self.mcmc:
            with torch.no_grad():
                self.params["scales"] += math.log(MCMC_SHRINK)
                self.params["opacities"].fill_(math.log(MCMC_OPACITY / (1 - MCMC_OPACITY)))
            self.strategy = MCMCStrategy(cap_max=cap)
            self.state = self.strategy.initialize_state()
        else:
            growth = {"absgrad": True, "grow_grad2d": GROW_ABSGRAD} if self.absgrad else {}
            self.strategy = DefaultStrategy(**growth)
            self.state = self.strategy.initialize_state(scene_scale=scale)
        self.strategy.refine_stop_iter = self.strategy.refine_stop_iter * steps // STEPS
        self.strategy.check_sanity(self.params, self.optimizers)

    def draw(self, target: Target, degree: int):
        """The picture (1, H, W, 3) and gsplat's info."""
        p = self.params
        drawn, _, info = rasterization(
            means=p["means"],
            quats=p["quats"],
            scales=torch.exp(p["scales"]),
            opacities=torch.sigmoid(p["opacities"]),
            colors=torch.cat([p["sh0"], p["shN"]], 1),
            viewmats=target.view,
            Ks=target.K,
            width=target.width,
            height=target.height,
            sh_degree=degree,
            packed=False,
            absgrad=self.absgrad,
        )
        return drawn, info

    def next_target(self) -> Target:
        """A view: all in a random order, then again."""
        if not self.queue:
            self.queue = self.rng.permutation(len(self.targets)).tolist()
        return self.targets[self.queue.pop()]

    def step(self) -> None:
        """Learn from one view, in the order of simple_trainer.py."""
        step, target = self.done, self.next_target()
        drawn, info = self.draw(target, min(step // DEGREE_INTERVAL, DEGREE))
        about = {"params": self.params, "optimizers": self.optimizers, "state": self.state, "step": step, "info": info}
        loss = target.loss(drawn)
        if self.mcmc:
            costs = torch.sigmoid(self.params["opacities"]).mean() + torch.exp(self.params["scales"]).mean()
            (loss + MCMC_COST * costs).backward()
        else:
            self.strategy.step_pre_backward(**about)
            loss.backward()
        self.optimize()
        self.decay.step()
        after = {"lr": self.decay.get_last_lr()[0]} if self.mcmc else {"packed": False}
        self.strategy.step_post_backward(**about, **after)
        self.done += 1

    def optimize(self) -> None:
        """A step of Adam for all parameters."""
        for optimizer in self.optimizers.values():
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)

    def now(self) -> float:
        """Time [s] when the device is done."""
        if self.device.type == "cuda":
            torch.cuda.synchronize()
        return time.perf_counter()

    @torch.no_grad()
    def qualities(self, targets) -> list[tuple[float, float]]:
        """PSNR and SSIM of each of `targets`."""
        return [t.quality(self.draw(t, DEGREE)[0]) for t in targets]


def train(path: Path, args, device) -> list[dict]:
    """A row for each of `args.at` steps. Raises BadInput."""
    capture, learned, kept = read_training_capture(path, args.reduce, args.test_every)
    start = first_gaussians(capture, learned, degree=DEGREE, cap=args.cap, seed=args.seed)
    targets, tests = [Target(p, device) for p in learned], [Target(p, device) for p in kept]
    about = {"strategy": args.strategy, "cap": args.cap, "seed": args.seed, "device": device}
    training = Training(targets, start, capture.extent, args.steps, **about)
    rows, seconds = [], 0.0
    while training.done < args.steps:
        begin = training.now()
        end = min([at for at in (*args.at, args.steps) if training.done < at <= args.steps])
        while training.done < end:
            training.step()
            if training.done % 1000 == 0:
                print(f"{path.name}: step {training.done}/{args.steps}", file=sys.stderr, flush=True)
        seconds += training.now() - begin
        qualities = training.qualities(tests)
        psnr, ssim = np.mean(qualities, axis=0)
        row = {"bench": "train", "program": f"gsplat 1.5.3, {args.strategy}", "capture": path.name}
        row["step"] = training.done
        row |= {"psnr": psnr, "ssim": ssim, "gaussians": len(training.params["means"]), "seconds": seconds}
        row["psnr_of_each"] = [round(quality[0], 2) for quality in qualities]
        row |= {"steps_per_second": training.done / seconds}
        row |= {"device_mb": device_memory(), "views": len(learned), "test_views": len(kept)}
        if device.type == "cuda":
            row |= {"tensors_mb": torch.cuda.max_memory_allocated() / 2**20, "device": torch.cuda.get_device_name()}
        rows.append(row)
        print_test(path.name, row)
    return rows


def main() -> int:
    """Train on each capture, print rows, write --json; exit status 2 for bad input."""
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE")
    p.add_argument("--steps", type=int, default=STEPS)
    p.add_argument("--at", type=int, nargs="+", default=[7000, STEPS], help="steps after which it is tested")
    p.add_argument("--reduce", type=int, default=1)
    p.add_argument("--test-every", type=int, default=8)
    p.add_argument("--cap", type=int, default=2_000_000, help="most points to start from; of mcmc most Gaussians")
    p.add_argument("--strategy", choices=STRATEGIES, default=STRATEGIES[0])
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--json", type=Path)
    p.add_argument("--device", default="cuda")
    args = p.parse_args()
    torch.backends.cudnn.allow_tf32 = False  # of SSIM's windows
    rows = []
    try:
        for path in args.captures:
            rows += train(path, args, torch.device(args.device))
            print_rows(rows)
            if args.json:
                write_json(args.json, rows)
    except BadInput as e:
        print(e, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
