"""Members of the family that fits the published F: python docs/examples/calibration.py [FOLDER]"""

import sys

import pyarrow.parquet as pq

rows = pq.read_table((sys.argv[1:] or ["runs/calibration-even"])[0] + "/trials").to_pylist()
trials = sorted((row for row in rows if row["kind"] == "trial"), key=lambda row: row["objectives.0"])
print("limits ±deg   R_y    R_z       K  misfit")
for row in trials[:15]:
    half, y, z, K = (
        row[f"parameters.{name}"] for name in ("half", "layout.offset.1", "layout.offset.2", "dexterity.K")
    )
    print(f"{half:11.0f}  {y:.3f}  {z:.3f}  {K:6.0f}  {row['objectives.0']:.3f}")
