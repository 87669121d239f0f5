#!/bin/bash
# A dataset as a Slurm job array: one shard a task, all into one shared folder.
#
#   sbatch slurm.sh --count 100000 --preset train_dr --out /shared/moon
#
# A task that is requeued, killed or out of time resumes: submit the same line again, or only its number with
# `sbatch --array=3,5 slurm.sh ...`. The last shard to finish completes the folder. For another number of shards:
# `SHARDS=100 sbatch --array=0-99 slurm.sh ...`. Without GPUs, remove --gres; Mesa's CPU driver then does the work.
#SBATCH --job-name=moon
#SBATCH --array=0-7
#SBATCH --cpus-per-task=4
#SBATCH --gres=gpu:1
#SBATCH --time=04:00:00
#SBATCH --requeue
#SBATCH --signal=TERM@60
set -euo pipefail

# From Slurm 22.05 on, srun does not take the number of cores from the job.
exec srun --cpus-per-task="$SLURM_CPUS_PER_TASK" \
    regolith-render dataset --shard "$SLURM_ARRAY_TASK_ID/${SHARDS:-8}" "$@"
