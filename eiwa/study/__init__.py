"""Studies: Optuna's search over designs, resumable, with one Parquet row per evaluated design."""
