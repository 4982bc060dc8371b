/** What the page shows, as something to be typed: on the command line, in Python, with curl. */

export interface Commands {
  cli: string;
  python: string;
  curl: string;
}

/** A table of a campaign, whole. */
export function tableCommands(origin: string, id: string, table: string, query: Record<string, string> = {}): Commands {
  const full = new URLSearchParams({ ...query, format: "csv" }).toString();
  const url = `${origin}/api/v1/campaigns/${id}/${table}`;
  return {
    cli: cliOf(id, table, query),
    python: clientPython(origin, `table = client.frame(${[JSON.stringify(id), JSON.stringify(table), ...keywords(query)].join(", ")}).to_pandas()`),
    curl: `curl -s '${url}?${full}' -o ${table}.csv`,
  };
}

function cliOf(id: string, table: string, query: Record<string, string>): string {
  if (table === "solutions" && query["weights"]) return `drivecal solutions ${id.slice(0, 8)} --weights ${query["weights"]}`;
  return `drivecal export ${id.slice(0, 8)} --table ${table} --format csv -o ${table}.csv`;
}

/** A campaign, a rerun or a comparison to submit. */
export function postCommands(origin: string, path: string, body: unknown, cli: string): Commands {
  const json = JSON.stringify(body);
  return {
    cli,
    python: clientPython(origin, `campaign = ${posted(path, pythonOf(body))}`),
    curl: `curl -s -X POST '${origin}/api/v1${path}' -H 'Content-Type: application/json' -d '${json.replaceAll("'", "'\\''")}'`,
  };
}

/** A call of the Python client; the token comes from DRIVECAL_TOKEN. */
export function clientPython(origin: string, call: string): string {
  return `from drivecal.client import Client\n\nwith Client("${origin}") as client:\n    ${call}`;
}

function keywords(query: Record<string, string>): string[] {
  return Object.entries(query).map(([name, value]) => `${name}=${JSON.stringify(value)}`);
}

function posted(path: string, body: string): string {
  const rerun = /^\/campaigns\/(.+)\/rerun$/.exec(path)?.[1];
  if (rerun !== undefined) return `client.rerun(${JSON.stringify(rerun)}, ${body})`;
  return `client.${path === "/comparisons" ? "compare" : "submit"}(${body})`;
}

/** A value as Python writes it. */
export function pythonOf(value: unknown): string {
  if (value === null || value === undefined) return "None";
  if (value === true) return "True";
  if (value === false) return "False";
  if (Array.isArray(value)) return `[${value.map(pythonOf).join(", ")}]`;
  if (typeof value === "object") {
    return `{${Object.entries(value)
      .map(([name, inner]) => `${JSON.stringify(name)}: ${pythonOf(inner)}`)
      .join(", ")}}`;
  }
  return JSON.stringify(value);
}
