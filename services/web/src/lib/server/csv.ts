/** Tables as CSV (RFC 4180). */

/** The numbers of a drawing. */
export interface Sheet {
  head: readonly string[];
  rows: readonly (readonly (string | number | null)[])[];
}

/** Texts that a spreadsheet would carry out as a formula begin with an apostrophe, as in the server's files. */
const isFormula = (text: string): boolean => /^[=+\-@\t\r]/.test(text) && Number.isNaN(Number(text));

/** A text of a file without the apostrophe that marks it as no formula. */
export function unmarked(text: string): string {
  return text.startsWith("'") && isFormula(text.slice(1)) ? text.slice(1) : text;
}

export function csvOf(sheet: Sheet): string {
  const field = (value: string | number | null): string => {
    const plain = value === null ? "" : String(value);
    const text = isFormula(plain) ? `'${plain}` : plain;
    return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  return [sheet.head, ...sheet.rows].map((row) => row.map(field).join(",")).join("\n") + "\n";
}
