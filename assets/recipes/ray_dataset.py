"""A dataset on a Ray cluster: one shard a task, all into one shared folder.

    python ray_dataset.py --shards 16 --cpus 4 --gpus 1 -- --count 100000 --preset train_dr --out /shared/moon

Arguments after `--` go to `regolith-render dataset`. A task that dies is restarted and resumes, and so does this
script: run the same line again. The last shard to finish completes the folder.
"""

import argparse
import subprocess

import ray


def render_shard(program: str, options: list[str], shard: int, shards: int, threads: int) -> int:
    """Renders one shard; raises the program's message if it fails."""
    # Ray counts cores, but confines no process to them.
    command = [program, "dataset", "--threads", str(threads), *options, "--shard", f"{shard}/{shards}", "--quiet"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"shard {shard}/{shards}: {done.stderr.strip()}")
    return shard


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shards", type=int, default=8, help="number of tasks")
    parser.add_argument("--cpus", type=int, default=2, help="cores per task, and its threads")
    parser.add_argument("--gpus", type=float, default=0, help="GPUs per task; Ray counts them, but a task sees all of its machine")
    parser.add_argument("--retries", type=int, default=3, help="how often a task is retried")
    parser.add_argument("--address", default=None, help="address of the cluster; default: RAY_ADDRESS, else this machine")
    parser.add_argument("--program", default="regolith-render", help="path of the binary")
    parser.add_argument("options", nargs="+", help="options of `regolith-render dataset`, after --")
    args = parser.parse_args()

    ray.init(address=args.address)
    task = ray.remote(num_cpus=args.cpus, num_gpus=args.gpus, max_retries=args.retries, retry_exceptions=True)(render_shard)
    waiting = [task.remote(args.program, args.options, shard, args.shards, args.cpus) for shard in range(args.shards)]
    finished = 0
    while waiting:
        done, waiting = ray.wait(waiting)
        ray.get(done)
        finished += len(done)
        print(f"{finished} of {args.shards} shards", flush=True)


if __name__ == "__main__":
    main()
