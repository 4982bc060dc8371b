#!/usr/bin/env bash
# drivecal on SLURM: a Ray node on each machine of the job, and the server with its API on the first one.
#
#   sbatch --nodes=4 --cpus-per-task=32 --time=08:00:00 deploy/examples/cluster/slurm.sh
#
# Needs drivecal[cluster] in the same place on all machines (VENV) and a folder that all of them see (SHARED). Campaigns survive the
# end of the job: the next one, with the same SHARED, goes on. A machine that is taken away costs no cell an attempt.
#SBATCH --job-name=drivecal
#SBATCH --ntasks-per-node=1
#SBATCH --exclusive
#SBATCH --signal=B:TERM@60
set -eu

VENV=${VENV:-$HOME/drivecal/.venv}
SHARED=${SHARED:-$HOME/drivecal/slurm}
PORT=${PORT:-6379}

umask 077
mkdir -p "$SHARED/home"
token=$SHARED/ray_token
test -s "$token" || "$VENV/bin/python" -c 'import secrets; print(secrets.token_urlsafe(32))' > "$token"
test -s "$SHARED/tokens" || "$VENV/bin/python" -c 'import secrets; print("me admin", secrets.token_urlsafe(24))' > "$SHARED/tokens"
export RAY_AUTH_MODE=token RAY_AUTH_TOKEN_PATH=$token

head=$(scontrol show hostnames "$SLURM_JOB_NODELIST" | head -n 1)
address=$(srun --nodes=1 --ntasks=1 --nodelist="$head" hostname -I | awk '{print $1}')
cpus=${SLURM_CPUS_PER_TASK:-$SLURM_CPUS_ON_NODE} # which srun does not inherit from sbatch

# The head simulates nothing, so that its machine gets a node with workers as well.
srun --nodes=1 --ntasks=1 --overlap --nodelist="$head" \
  env DRIVECAL_NODE_ADDRESS="$address" "$VENV/bin/python" -m drivecal.cluster head --port "$PORT" &
srun --ntasks="$SLURM_JOB_NUM_NODES" --ntasks-per-node=1 --cpus-per-task="$cpus" --overlap \
  "$VENV/bin/python" -m drivecal.cluster worker "$address:$PORT" --cpus "$cpus" &

trap 'kill $(jobs -p) 2>/dev/null; wait' TERM EXIT
DRIVECAL_HOME=$SHARED/home DRIVECAL_RAY_ADDRESS=$address:$PORT DRIVECAL_RESOURCES=${DRIVECAL_RESOURCES:-} \
  "$VENV/bin/drivecal" serve --host 0.0.0.0 --tokens-file "$SHARED/tokens" &
wait -n
