"""Run a study on a SLURM cluster: python slurm.py STUDY.toml"""

import sys

from dask_jobqueue import SLURMCluster

import eiwa

THREADS = 8

if __name__ == "__main__":
    jobs = SLURMCluster(
        queue="normal",  # your partition
        walltime="12:00:00",
        processes=1,
        cores=1,  # a worker evaluates one design at a time ...
        job_cpu=THREADS,  # ... on so many processors
        memory="8GB",
    )
    with jobs:
        jobs.scale(jobs=8)  # as many as the study's batch
        settings = {
            "execution.executor": "dask",
            "execution.scheduler": jobs.scheduler_address,
            "execution.threads": THREADS,
        }
        eiwa.run(eiwa.load(sys.argv[1], settings))
