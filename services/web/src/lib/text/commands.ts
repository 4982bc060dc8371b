/** What the page shows, as commands: for the command line, Python and curl. */

export interface Commands {
  cli: string;
  python: string;
  curl: string;
}

/** The address of a table as a file; `where`: conditions on its rows. */
export function tableFile(id: string, table: string, format: string, query: Readonly<Record<string, string>>, where: readonly string[]): string {
  return `/api/v1/campaigns/${id}/${table}?${new URLSearchParams([...Object.entries(query), ...where.map((condition): [string, string] => ["where", condition]), ["format", format]])}`;
}

/** A table of a campaign: all rows that keep the conditions. */
export function tableCommands(origin: string, id: string, table: string, query: Readonly<Record<string, string>> = {}, where: readonly string[] = []): Commands {
  const arguments_ = [JSON.stringify(id), JSON.stringify(table), ...keywords(query), ...(where.length > 0 ? [`where=${pythonOf(where)}`] : [])];
  const flags = [...options(query), ...where.map((condition) => `--where ${quoted(condition)}`)];
  return {
    cli: [`drivecal export ${id.slice(0, 8)} --table ${table} --format csv`, ...flags, `-o ${table}.csv`].join(" "),
    python: clientPython(origin, `table = client.frame(${arguments_.join(", ")}).to_pandas()`),
    curl: `curl -s '${origin}${tableFile(id, table, "csv", query, where).replaceAll("'", "%27")}' -o ${table}.csv`,
  };
}

/** Two sets of a front by their ranks: what the second gains and costs. */
export function tradeOffCommands(origin: string, id: string, first: number, second: number, query: Readonly<Record<string, string>>): Commands {
  return {
    cli: [`drivecal front ${id.slice(0, 8)} --between ${first},${second}`, ...options(query)].join(" "),
    python: clientPython(origin, `answer = client.trade_off(${[JSON.stringify(id), first, second, ...keywords(query)].join(", ")})`),
    curl: `curl -s '${origin}/api/v1/campaigns/${id}/front/trade-off?${new URLSearchParams({ first: String(first), second: String(second), ...query })}'`,
  };
}

/** The address of a set as a file for calibration tools; without a rank the best one. */
export function calibrationFile(id: string, format: string, set: Readonly<Record<string, string>> = {}): string {
  return `/api/v1/campaigns/${id}/calibration-file?${new URLSearchParams({ ...set, format })}`;
}

/** Options of the command line; what is true needs no value. */
function options(query: Readonly<Record<string, string>>): string[] {
  return Object.entries(query).map(([name, value]) => (value === "true" ? `--${name}` : `--${name} ${quoted(value)}`));
}

/** A word of a shell. Windows knows double quotes alone; other shells read some characters within them. */
function quoted(text: string): string {
  if (/^[\w.,:/=-]+$/.test(text)) return text;
  return /["$`\\!%]/.test(text) ? `'${text.replaceAll("'", "'\\''")}'` : `"${text}"`;
}

/** Copies a text; false if the browser gives the page no clipboard, as on plain http. */
export async function copied(text: string): Promise<boolean> {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return false;
  }
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

function keywords(query: Readonly<Record<string, string>>): string[] {
  return Object.entries(query).map(([name, value]) => `${name}=${value === "true" ? "True" : JSON.stringify(value)}`);
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
