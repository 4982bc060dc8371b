#!/bin/sh
# Makes the secrets of the cluster where they are missing, and says how to reach it:
#
#     eval "$(deploy/secrets.sh)"     # afterwards `drivecal` finds the cluster and shows its token
#
# postgres_password  between the database and the API, which owns it
# dispatcher_password between the database and the dispatcher, which reads and writes rows
# ray_token          between the nodes of the Ray cluster; nodes on other machines need the same
# tokens             who may use the API: NAME read|write|author|admin TOKEN, a line each; add lines as you like, the server reads them again
#
# With DRIVECAL_ALLOW_PUSH=true, `tokens` gets a line with an author if it has none, and the author's token is the one that is shown: it
# pushes problems, which are code that the workers run. Nothing that exists is ever replaced. Only you can enter the folder; inside, the files are readable, for the users in the containers are
# others than you. The folder is deploy/secrets, or DRIVECAL_SECRETS.
set -eu
cd "$(dirname "$0")/.."

setting() { # NAME DEFAULT: from the environment, else from .env, without quotes and comment as docker compose takes it
    eval "value=\${$1:-}"
    [ -n "$value" ] || [ ! -f .env ] || value=$(sed -n "s/^$1=\(.*\)/\1/p" .env | tail -n 1 |
        sed "s/[[:space:]]\{1,\}#.*//; s/[[:space:]]*$//; s/^\"\(.*\)\"$/\1/; s/^'\(.*\)'$/\1/")
    printf '%s' "${value:-$2}"
}
random() { od -An -tx1 -N32 /dev/urandom | tr -d ' \n'; }
make() { # FILE CONTENT: in one step, so that no reader sees half a secret
    [ -e "$folder/$1" ] && return
    printf '%s\n' "$2" >"$folder/$1.$$"
    chmod 644 "$folder/$1.$$"
    mv "$folder/$1.$$" "$folder/$1"
}

folder=$(setting DRIVECAL_SECRETS deploy/secrets)
umask 077
[ -d "$folder" ] || { mkdir -p "$folder" && chmod 700 "$folder"; }
make postgres_password "$(random)"
make dispatcher_password "$(random)"
make ray_token "$(random)"
make tokens "me write $(random)"
role=write
if [ "$(setting DRIVECAL_ALLOW_PUSH "")" = true ]; then
    role=author
    [ -z "$(tail -c 1 "$folder/tokens")" ] || echo >>"$folder/tokens" # an edited file may lack its last line break
    grep -Eq '^[[:space:]]*[A-Za-z0-9][^[:space:]]*[[:space:]]+author[[:space:]]' "$folder/tokens" ||
        printf 'author author %s\n' "$(random)" >>"$folder/tokens"
fi

quoted() { # for eval: whatever a token or an address holds, the shell takes it as one word and runs nothing
    printf "'%s'" "$(printf '%s' "$1" | sed "s/'/'\\\\''/g")"
}
address=$(setting DRIVECAL_BIND 127.0.0.1)
case $address in # a client cannot call 0.0.0.0 or ::; in a URL, an address with colons stands in brackets
0.0.0.0) address=127.0.0.1 ;;
:: | '[::]') address='[::1]' ;;
\[*) ;;
*:*) address="[$address]" ;;
esac
token=$(sed -n 's/^[[:space:]]*[A-Za-z0-9][^[:space:]]*[[:space:]]\{1,\}'"$role"'[[:space:]]\{1,\}\([^[:space:]]*\).*/\1/p' "$folder/tokens" | head -n 1)

echo "export DRIVECAL_URL=$(quoted "http://$address:$(setting DRIVECAL_PORT 8000)")"
[ -z "$token" ] || echo "export DRIVECAL_TOKEN=$(quoted "$token")"
