"""Runs the recipes of assets/recipes and compares their datasets with an unsharded run.

Ray runs with two workers on this machine. Slurm and Kubernetes are simulated by what they give a task: environment
variables, a command line, and other tasks at the same time.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml

RECIPES = Path(__file__).parents[2] / "assets" / "recipes"
SCENE = ["--size", "48", "--samples", "1", "--set", "terrain.cells=40", "--set", "rocks.count=12"]
FRAMES = 12


def environment(program: Path, folder: Path, **variables: str) -> dict[str, str]:
    """The environment of a task: the program and a fake srun on the PATH, and the CPU driver. Like that of Slurm 22.05 the fake one demands
    the number of cores."""
    tools = folder / "tools"
    tools.mkdir(exist_ok=True)
    srun = tools / "srun"
    srun.write_text('#!/bin/sh\n[ "$1" = "--cpus-per-task=$SLURM_CPUS_PER_TASK" ] || exit 64\nshift\nexec "$@"\n')
    srun.chmod(0o755)
    path = f"{tools}:{program.parent}:{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "WGPU_ADAPTER_NAME": "cpu", **variables}


def run_together(commands: list[tuple[list[str], dict[str, str]]]) -> None:
    """Starts all commands at once; each must succeed."""
    tasks = [subprocess.Popen(command, env=env, stdout=subprocess.DEVNULL) for command, env in commands]
    for task, (command, _) in zip(tasks, commands, strict=True):
        if task.wait() != 0:
            sys.exit(f"{command} ended with {task.returncode}")


def slurm(program: Path, folder: Path, out: Path) -> None:
    """Two tasks of an array of three, then the third alone, as one that is submitted again."""
    options = ["--count", str(FRAMES), "--out", str(out), "--quiet", *SCENE]
    for array in ((0, 2), (1,)):
        tasks = []
        for task in array:
            variables = {"SLURM_ARRAY_TASK_ID": str(task), "SLURM_ARRAY_TASK_COUNT": str(len(array)), "SLURM_CPUS_PER_TASK": "4"}
            tasks.append(([str(RECIPES / "slurm.sh"), *options], environment(program, folder, SHARDS="3", **variables)))
        run_together(tasks)


def kubernetes(program: Path, folder: Path, out: Path) -> None:
    """Every pod of the job, with fewer shards and frames, and with the options of the small scene."""
    job = yaml.safe_load((RECIPES / "kubernetes.yaml").read_text())["spec"]
    container = job["template"]["spec"]["containers"][0]
    variables = {row["name"]: row["value"] for row in container["env"]}
    if int(variables["SHARDS"]) != job["completions"] or job["completionMode"] != "Indexed":
        sys.exit("kubernetes.yaml: SHARDS differs from the completions of an indexed job")
    variables |= {"SHARDS": "2", "COUNT": str(FRAMES), "OUT": str(out)}
    script = container["args"][0].replace('--preset "$PRESET"', " ".join([*SCENE, "--quiet"]))
    command = [*container["command"], script]
    run_together(
        [(command, environment(program, folder, JOB_COMPLETION_INDEX=str(index), **variables)) for index in range(2)]
    )


def ray(program: Path, folder: Path, out: Path) -> None:
    """Four shards on two workers."""
    command = [sys.executable, str(RECIPES / "ray_dataset.py"), "--shards", "4", "--cpus", "1", "--program", str(program)]
    options = ["--count", str(FRAMES), "--out", str(out), *SCENE]
    env = environment(program, folder, RAY_USAGE_STATS_ENABLED="0", RAY_DEDUP_LOGS="0")
    done = subprocess.run([*command, "--", *options], env=env, capture_output=True, text=True)
    if done.returncode != 0 or "4 of 4 shards" not in done.stdout:
        sys.exit(f"ray: {done.stdout}\n{done.stderr}")
    # The program's message must reach the user.
    failing = [*command, "--retries", "0", "--", *options, "--set", "sun.elevation_deg=95"]
    done = subprocess.run(failing, env=env, capture_output=True, text=True)
    if done.returncode == 0 or "sun.elevation_deg = 95" not in done.stderr:
        sys.exit(f"ray swallows an error: {done.stderr}")


def content(folder: Path) -> dict[str, object]:
    """Every file below a folder; the lines of frames.jsonl without the milliseconds."""
    files: dict[str, object] = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            files[str(path.relative_to(folder))] = path.read_bytes()
    lines = [json.loads(line) for line in (folder / "frames.jsonl").read_text().splitlines()]
    files["frames.jsonl"] = [{key: value for key, value in line.items() if key != "ms"} for line in lines]
    return files


def main() -> None:
    program = Path(os.environ["REGOLITH_BINARY"])
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        whole = folder / "whole"
        command = [str(program), "dataset", "--count", str(FRAMES), "--out", str(whole), "--quiet", *SCENE]
        subprocess.run(command, env=environment(program, folder), check=True, stdout=subprocess.DEVNULL)
        for recipe in (slurm, kubernetes, ray):
            out = folder / recipe.__name__
            recipe(program, folder, out)
            made, wanted = content(out), content(whole)
            different = [name for name in made.keys() | wanted.keys() if made.get(name) != wanted.get(name)]
            if different:
                sys.exit(f"{recipe.__name__}: differs from the unsharded run: {sorted(different)}")
            print(f"{recipe.__name__:<12} {FRAMES} frames, the same bytes as the unsharded run")


if __name__ == "__main__":
    main()
