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
    python: `import httpx\n\nrows = httpx.get("${url}", params=${pythonOf({ ...query, limit: "1000" })}).json()["items"]`,
    curl: `curl -s '${url}?${full}' -o ${table}.csv`,
  };
}

function cliOf(id: string, table: string, query: Record<string, string>): string {
  if (table === "solutions" && query["weights"]) return `drivecal solutions ${id.slice(0, 8)} --weights ${query["weights"]}`;
  return `drivecal export ${id.slice(0, 8)} --table ${table} --format csv -o ${table}.csv`;
}

/** Anything that is posted. */
export function postCommands(origin: string, path: string, body: unknown, cli: string): Commands {
  const json = JSON.stringify(body);
  return {
    cli,
    python: `import httpx\n\nanswer = httpx.post("${origin}/api/v1${path}", json=${pythonOf(body)}).json()`,
    curl: `curl -s -X POST '${origin}/api/v1${path}' -H 'Content-Type: application/json' -d '${json.replaceAll("'", "'\\''")}'`,
  };
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
