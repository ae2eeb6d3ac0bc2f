"""Pictures of Gaussians in plain PyTorch on the CPU, by gsplat's rules. Runs in an environment of its own.

    python torch_splats.py CASE.npz OUT.npz

CASE holds means (N, 3) [m], quats (N, 4) wxyz, scales (N, 3) [m], opacities (N,), sh (N, K, 3), world_to_camera (4, 4),
lens = fx, fy, cx, cy [px], size = width, height [px], rounds. OUT: rgb (H, W, 3), alpha, depth [m] (H, W), seconds of
each round, CPU seconds of each, pairs of tile and Gaussian, threads, version.

Everything is done for all Gaussians, or for all pixels of a tile and a run of its Gaussians, at once.
"""

import sys
import time

try:
    import torch
except ImportError as e:
    sys.exit(f"PyTorch cannot be imported ({e}): pip install -r tests/bench/requirements-torch.txt")
import numpy as np

TILE = 8  # [px]; 16 took about as long, 32 three times
RUN = 128  # Gaussians that are blended at once: a tile whose pixels are all finished stops after these
NEAR, DILATION, ALPHA_MAX, ALPHA_MIN, OPAQUE = 0.01, 0.3, 0.999, 1 / 255, 1e-4


def rotations(q):
    """Matrices (N, 3, 3) of unit quaternions wxyz."""
    w, x, y, z = q.unbind(1)
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
    rows += [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
    rows += [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    return torch.stack(rows, 1).reshape(-1, 3, 3)


def harmonics(d, count: int):
    """Values (N, count) of the real spherical harmonics of degree 0 to 3 at unit directions."""
    x, y, z = d.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    b = [torch.full_like(x, 0.28209479177387814)]
    if count > 1:
        b += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if count > 4:
        b += [1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * zz - xx - yy)]
        b += [-1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy)]
    if count > 9:
        b += [-0.5900435899266435 * y * (3 * xx - yy), 2.890611442640554 * x * y * z]
        b += [-0.4570457994644658 * y * (4 * zz - xx - yy), 0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy)]
        b += [-0.4570457994644658 * x * (4 * zz - xx - yy), 1.445305721320277 * z * (xx - yy)]
        b += [-0.5900435899266435 * x * (xx - 3 * yy)]
    return torch.stack(b, 1)


def project(case, lens, width: int, height: int):
    """Pixel means, conics (A, B, C), opacities, depths, colours and half sizes of what may be seen, front to back."""
    W, t = case["world_to_camera"][:3, :3], case["world_to_camera"][:3, 3]
    p = case["means"] @ W.T + t
    chosen = torch.nonzero((p[:, 2] >= NEAR) & (case["opacities"] >= ALPHA_MIN)).squeeze(1)
    chosen = chosen[torch.sort(p[chosen, 2], stable=True).indices]
    p, opacity = p[chosen], case["opacities"][chosen]
    (fx, fy, cx, cy), z = lens, p[:, 2]
    edge_x, edge_y = 0.15 * width / fx, 0.15 * height / fy  # 0.3 tan(fov / 2)
    x = (p[:, 0] / z).clamp(-cx / fx - edge_x, (width - cx) / fx + edge_x)
    y = (p[:, 1] / z).clamp(-cy / fy - edge_y, (height - cy) / fy + edge_y)
    zero = torch.zeros_like(z)
    J = torch.stack([fx / z, zero, -fx * x / z, zero, fy / z, -fy * y / z], 1).reshape(-1, 2, 3)
    half = J @ (W @ rotations(case["quats"][chosen])) * case["scales"][chosen][:, None, :]  # J W R S
    sigma = half @ half.transpose(1, 2)
    a, b, c = sigma[:, 0, 0] + DILATION, sigma[:, 0, 1], sigma[:, 1, 1] + DILATION
    det = a * c - b * b
    mean = torch.stack([fx * p[:, 0] / z + cx, fy * p[:, 1] / z + cy], 1)
    reach = torch.sqrt(2 * torch.log(255 * opacity.clamp(max=1.0)).clamp(min=0.0))
    size = torch.stack([reach * torch.sqrt(a), reach * torch.sqrt(c)], 1)
    middle = torch.tensor([0.5 * width, 0.5 * height])
    seen = torch.nonzero(((mean - middle).abs() < size + middle).all(1) & (det > 0)).squeeze(1)
    d = case["means"][chosen[seen]] + W.T @ t
    basis = harmonics(torch.nn.functional.normalize(d, dim=1), case["sh"].shape[1])
    color = torch.einsum("nk,nkc->nc", basis, case["sh"][chosen[seen]]).add(0.5).clamp(min=0.0)
    conic = torch.stack([c / det, -b / det, a / det], 1)
    return mean[seen], conic[seen], opacity[seen], z[seen], color, size[seen]


def bins(mean, size, width: int, height: int):
    """Gaussians of each tile, front to back as they were, and where those of each tile begin and end."""
    columns, rows = -(-width // TILE), -(-height // TILE)
    low, high = torch.floor((mean - size) / TILE).long(), torch.floor((mean + size) / TILE).long() + 1
    left, right = low[:, 0].clamp(0, columns), high[:, 0].clamp(0, columns)
    top, bottom = low[:, 1].clamp(0, rows), high[:, 1].clamp(0, rows)
    wide = right - left
    count = wide * (bottom - top)
    owner = torch.repeat_interleave(torch.arange(len(mean)), count)
    place = torch.arange(len(owner)) - (count.cumsum(0) - count)[owner]
    tile = (top[owner] + place // wide[owner]) * columns + left[owner] + place % wide[owner]
    order = torch.sort(tile, stable=True).indices
    ends = torch.bincount(tile, minlength=columns * rows).cumsum(0)
    return owner[order], torch.cat([ends.new_zeros(1), ends]).tolist(), columns, rows


def blend(found, width: int, height: int):
    """rgb, alpha, depth sums (H, W, 3 + 1 + 1), and how many pairs of tile and Gaussian there were."""
    mean, _, _, z, color, size = found
    members, ends, columns, rows = bins(mean, size, width, height)
    values = torch.cat([color, z[:, None]], 1)
    image = torch.zeros(rows * TILE, columns * TILE, 5)
    for tile in range(columns * rows):
        if ends[tile + 1] > ends[tile]:
            x0, y0 = tile % columns * TILE, tile // columns * TILE
            drawn = blend_tile(found, values, members[ends[tile] : ends[tile + 1]], x0, y0)
            image[y0 : y0 + TILE, x0 : x0 + TILE] = drawn.reshape(TILE, TILE, 5)
    return image[:height, :width], len(members)


def blend_tile(found, values, members, x0: int, y0: int):
    """Sums (pixels, 3 + 1 + 1) of a tile whose corner is (x0, y0) [px]; `members` front to back."""
    mean, conic, opacity = found[:3]
    at = torch.arange(TILE) + 0.5
    v, u = (a.reshape(-1) for a in torch.meshgrid(at + y0, at + x0, indexing="ij"))
    T, sums = torch.ones(1, TILE * TILE), torch.zeros(TILE * TILE, 4)
    going_on = torch.ones(TILE * TILE, dtype=torch.bool)
    for g in members.split(RUN):
        dx, dy = u - mean[g, 0:1], v - mean[g, 1:2]
        A, B, C = conic[g, 0:1], conic[g, 1:2], conic[g, 2:3]
        alpha = opacity[g, None] * torch.exp(-0.5 * (A * dx * dx + C * dy * dy) - B * dx * dy)
        alpha = torch.where(alpha < ALPHA_MIN, 0.0, alpha.clamp(max=ALPHA_MAX))
        after = T * torch.cumprod(1 - alpha, 0)
        before = torch.cat([T, after[:-1]])
        kept = (after > OPAQUE) & going_on
        sums += torch.where(kept, alpha * before, 0.0).T @ values[g]
        T = torch.where(kept, after, 2.0).amin(0, keepdim=True).minimum(T)  # after the last one that was kept
        going_on = kept[-1]
        if not going_on.any():
            break
    return torch.cat([sums[:, :3], 1 - T.T, sums[:, 3:]], 1)


@torch.inference_mode()
def run(case) -> dict:
    """What OUT holds."""
    names = ("means", "quats", "scales", "opacities", "sh", "world_to_camera")
    tensors = {name: torch.tensor(case[name], dtype=torch.float32) for name in names}
    lens, (width, height) = case["lens"].tolist(), case["size"].tolist()
    seconds, cpu, threads = [], [], torch.get_num_threads()
    for _ in range(int(case["rounds"]) + 1):
        begin, spent = time.perf_counter(), time.process_time()
        torch.set_num_threads(threads)
        found = project(tensors, lens, width, height)
        torch.set_num_threads(1)  # a tile is too small to be shared, and tiles given to threads wait for Python's lock
        image, pairs = blend(found, width, height)
        seconds.append(time.perf_counter() - begin)
        cpu.append(time.process_time() - spent)
    alpha = image[..., 3]
    depth = image[..., 4] / alpha.clamp(min=1e-10)
    out = {"rgb": image[..., :3].numpy(), "alpha": alpha.numpy(), "depth": depth.numpy(), "seconds": seconds[1:]}
    return {**out, "cpu": cpu[1:], "pairs": pairs, "threads": threads, "version": torch.__version__}


if __name__ == "__main__":
    np.savez(sys.argv[2], **run(np.load(sys.argv[1])))
