/** Tables as CSV (RFC 4180). */

/** The numbers beside a drawing. */
export interface Sheet {
  head: readonly string[];
  rows: readonly (readonly (string | number | null)[])[];
}

/** Texts that a spreadsheet would carry out as a formula begin with an apostrophe, as in the server's files. */
export function csvOf(sheet: Sheet): string {
  const field = (value: string | number | null): string => {
    const plain = value === null ? "" : String(value);
    const text = /^[=+\-@\t\r]/.test(plain) && Number.isNaN(Number(plain)) ? `'${plain}` : plain;
    return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  return [sheet.head, ...sheet.rows].map((row) => row.map(field).join(",")).join("\n") + "\n";
}
