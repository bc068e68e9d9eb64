"""Both designs of the paper's study with one assumption changed at a time: python docs/examples/one_at_a_time.py"""

import eiwa
from eiwa.core.outcome import measurements

JOINTS = ("waist", "shoulder", "upper", "fore", "pitch", "roll")
CHANGES = {
    "as written": {},
    "R_y = 0.70 m": {"layout.offset.1": 0.70},
    "R_y = 0.60 m": {"layout.offset.1": 0.60},
    "R_z = 0.00 m": {"layout.offset.2": 0.0},
    "R_z = 0.20 m": {"layout.offset.2": 0.2},
    "base x to the right": {"layout.orientation": [0.0, 0.0, 0.0]},
    "second arm mirrored": {"layout.second": "mirrored"},
    "D = 0.40 m in both": {"layout.spacing": 0.40},
    "D = 0.60 m in both": {"layout.spacing": 0.60},
    "limits ±90 deg": {f"arm.joints.{name}.limits": [-90.0, 90.0] for name in JOINTS},
    "limits ±150 deg": {f"arm.joints.{name}.limits": [-150.0, 150.0] for name in JOINTS},
    "K = 50": {"dexterity.K": 50.0},
    "K = 100000": {"dexterity.K": 100_000.0},
    "translation rows": {"dexterity.rows": "translation"},
    "threshold 0": {"dexterity.threshold": 0.0},
    "threshold 0.5": {"dexterity.threshold": 0.5},
    "normaliser 0.01035": {"dexterity.normaliser": 0.01035},
    "power grip, 0.060 m": {"human.grip": 0.060},
    "fingertips, 0.187 m": {"human.grip": 0.187},
    "no toe-in": {"human.toe_in": 0.0},
    "no roll": {"human.roll": [0.0, 0.0]},
    "armrest 0.05 m up": {"operator.armrest": 0.05},
    "V_R = union": {"metrics.F.volume": "union"},
    "mean per voxel": {"voxels.aggregate": "mean"},
    "r = 10 mm": {"voxels.size": 0.01},
    "r = 40 mm": {"voxels.size": 0.04},
    "N = 2^22": {"sampling.samples": 1 << 22},
    "N = 2^24": {"sampling.samples": 1 << 24},
    "r = 10 mm, N = 2^24": {"voxels.size": 0.01, "sampling.samples": 1 << 24},
    "Sobol points": {"sampling.estimator": "sobol"},
    "elites, 1 %": {"sampling.estimator": "elites", "sampling.samples": 1 << 24},
}

if __name__ == "__main__":
    spec = eiwa.load("studies/paper.toml", {"scenarios": {}, "metrics": {"F": {}}})
    for name, design in spec.designs.items():
        ((_, measurement),) = measurements(spec, design.overrides)
        print(f"largest Dex of {name} before normalisation: {measurement.dexterity.normaliser:.6f}")
    for name, change in CHANGES.items():
        original, optimum = (
            eiwa.evaluate(spec, {**spec.designs[design].overrides, **change}, replicates=4).scenarios[""]
            for design in ("original", "optimum")
        )
        F, F_opt = original["F"], optimum["F"]
        pair = f"{F:.4f} ± {original['F_se']:.4f} | {F_opt:.4f} ± {optimum['F_se']:.4f}"
        print(f"| {name:20} | {pair} | {f'{F_opt / F:.1f}' if F else '-':>6} | {optimum['F_drift']:.4f} |", flush=True)
