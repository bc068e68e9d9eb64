"""The true maximum per voxel, by routes that share nothing with the sampler.

For the paper's arm the tip depends on q1, q2, q3 alone and is inverted in closed form:
p = Rz(q1) (A cos q2, L2 sin q3, A sin q2) with A = L1 + L2 cos q3. The manipulability is h(q2, q3) |sin q5|, Eq. (1)'s
product is best with q4 and q6 at mid-range, so the best value at a tip is h g(m) with m the product over q1..q3 and
g(m) = max over q5 of |sin q5| (1 - exp(-K' m 4 u5 (1 - u5))), a function of one number that is tabulated.
"""

import numpy as np


class PaperArm:
    """Best Dex at points of the base frame, for limits +-half [rad] on all six joints."""

    def __init__(self, L1, L2, half, K):
        self.L1, self.L2, self.half = L1, L2, half
        q5 = np.linspace(0, half, 2001)
        u5 = 0.5 + q5 / (2 * half)
        self.m = np.linspace(0, 1, 1001)
        penalty = -np.expm1(-K * 4.0**-6 * self.m[:, None] * 4 * u5 * (1 - u5))
        self.g = np.max(np.abs(np.sin(q5)) * penalty, axis=1)

    def best(self, p):
        """Largest w (1 - exp(...)) over the postures that reach each point p (n, 3); 0 where none does."""
        x, y, z = p.T
        cos3 = (x**2 + y**2 + z**2 - self.L1**2 - self.L2**2) / (2 * self.L1 * self.L2)
        A = self.L1 + self.L2 * np.clip(cos3, -1, 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            sin2 = np.where(A != 0, z / A, 2.0)
        reachable = (np.abs(cos3) <= 1) & (np.abs(sin2) <= 1)
        q3, q2 = np.arccos(np.clip(cos3, -1, 1)), np.arcsin(np.clip(sin2, -1, 1))
        return np.max([self._value(x, y, A, a, b, reachable) for a in (q2, np.pi - q2) for b in (q3, -q3)], axis=0)

    def _value(self, x, y, A, q2, q3, reachable):
        q1 = np.arctan2(y, x) - np.arctan2(self.L2 * np.sin(q3), A * np.cos(q2))
        q = (np.stack([q1, q2, q3]) + np.pi) % (2 * np.pi) - np.pi
        u = 0.5 + q / (2 * self.half)
        inside = reachable & np.all((u >= 0) & (u <= 1), axis=0)
        h = np.abs(self.L1 * self.L2 * np.cos(q2) * np.sin(q3) * A)
        return np.where(inside, h * np.interp(np.prod(4 * u * (1 - u), axis=0), self.m, self.g), 0.0)

    def maximum(self):
        """Largest value anywhere (q1 at mid-range), on a fine grid of q2 and q3."""
        q = np.linspace(-self.half, self.half, 2401)
        b = 1 - (q / self.half) ** 2
        h = np.abs(np.cos(q)[:, None] * self.L1 * self.L2 * np.sin(q) * (self.L1 + self.L2 * np.cos(q)))
        return float((h * np.interp(b[:, None] * b, self.m, self.g)).max())

    def cells(self, T_base_grid, lows, r, points=5):
        """Suprema over cubes with lower corners ``lows`` (n, 3) in a grid frame, from points^3 points each."""
        ticks = np.linspace(0, r, points)
        offsets = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
        R, t = T_base_grid[:3, :3].T, T_base_grid[:3, 3]
        return np.max([self.best((lows + offset) @ R + t) for offset in offsets], axis=0)


def planar_cells(L1, L2, lows, r):
    """Suprema of w = L1 L2 |sin q2| over squares with lower corners ``lows`` (n, 2) [m], no joint limits.

    w depends on the distance from the base alone and is largest at sqrt(L1^2 + L2^2), where q2 is a right angle.
    """
    highs = lows + r
    nearest = np.where((lows <= 0) & (highs >= 0), 0.0, np.minimum(np.abs(lows), np.abs(highs)))
    farthest = np.maximum(np.abs(lows), np.abs(highs))
    near, far = np.linalg.norm(nearest, axis=1), np.linalg.norm(farthest, axis=1)
    distance = np.clip(np.hypot(L1, L2), np.maximum(near, abs(L1 - L2)), np.minimum(far, L1 + L2))
    cos2 = (distance**2 - L1**2 - L2**2) / (2 * L1 * L2)
    reached = (far >= abs(L1 - L2)) & (near <= L1 + L2)
    return np.where(reached, L1 * L2 * np.sqrt(np.clip(1 - cos2**2, 0, None)), 0.0)
