#!/bin/bash
# A dataset as a Slurm job array: one shard a task, all into one shared folder.
#
#   sbatch slurm.sh --count 100000 --preset train_dr --out /shared/moon
#
# A task that is requeued, killed or out of time resumes: submit the same line again. The last shard to finish
# completes the folder. Without GPUs, remove --gres; Mesa's CPU driver then does the work.
#SBATCH --job-name=moon
#SBATCH --array=0-7
#SBATCH --cpus-per-task=4
#SBATCH --gres=gpu:1
#SBATCH --time=04:00:00
#SBATCH --requeue
#SBATCH --signal=TERM@60
set -euo pipefail

shard=$((SLURM_ARRAY_TASK_ID - SLURM_ARRAY_TASK_MIN))/$SLURM_ARRAY_TASK_COUNT
exec srun regolith-render dataset --shard "$shard" "$@"
