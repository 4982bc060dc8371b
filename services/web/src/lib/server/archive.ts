/** A dropped or chosen folder as the zip that `POST /problems` takes. Nothing is compressed. */

/** Folders that no problem needs: the server leaves them out as well. */
const IGNORED = [".git", "__pycache__", ".venv", ".drivecal"];
/** A browser does not know which files may be run: files that begin like a script or a Linux program may. */
const PROGRAMS = ["#!", "\x7fELF"];
type Named<T> = readonly [name: string, content: T];

/** The files below an entry of a drop, by their path. */
export async function filesBelow(entry: FileSystemEntry, path = ""): Promise<Named<File>[]> {
  if (IGNORED.includes(entry.name)) return [];
  if (entry.isFile) return [[path + entry.name, await new Promise<File>((done, fail) => (entry as FileSystemFileEntry).file(done, fail))]];
  const [reader, inner] = [(entry as FileSystemDirectoryEntry).createReader(), [] as FileSystemEntry[]];
  const some = (): Promise<FileSystemEntry[]> => new Promise((done, fail) => reader.readEntries(done, fail)); // at most 100 at a time
  for (let read = await some(); read.length > 0; read = await some()) inner.push(...read);
  return (await Promise.all(inner.map((each) => filesBelow(each, `${path}${entry.name}/`)))).flat();
}

/** The archive of files whose paths begin with their folder; a single zip is one already. */
export async function archiveOf(files: readonly Named<File>[]): Promise<{ name: string; files: number | null; content: Blob }> {
  const [path, only] = files[0] ?? ["", null];
  if (files.length === 1 && only && path.endsWith(".zip")) return { name: path, files: null, content: only };
  const kept = files.filter(([name]) => !name.split("/").some((part) => IGNORED.includes(part)));
  const read = await Promise.all(kept.map(async ([name, file]): Promise<Named<Uint8Array>> => [name.slice(name.indexOf("/") + 1), new Uint8Array(await file.arrayBuffer())]));
  return { name: path.split("/")[0] ?? "", files: read.length, content: new Blob(zipped(read) as Uint8Array<ArrayBuffer>[]) };
}

/** The value of the header `Drivecal-Push`: the digest of a content and its signature by a secret, as the command makes them. */
export async function signed(content: Blob, secret: string): Promise<string> {
  const bytes = new TextEncoder();
  const hex = (buffer: ArrayBuffer): string => Array.from(new Uint8Array(buffer), (byte) => byte.toString(16).padStart(2, "0")).join("");
  const digest = hex(await crypto.subtle.digest("SHA-256", await content.arrayBuffer()));
  const key = await crypto.subtle.importKey("raw", bytes.encode(secret), { name: "HMAC", hash: "SHA-256" }, false, ["sign"]);
  return `${digest}:${hex(await crypto.subtle.sign("HMAC", key, bytes.encode(`drivecal push ${digest}`)))}`;
}

const TABLE = Uint32Array.from({ length: 256 }, (_, byte) => Array.from({ length: 8 }).reduce((sum: number) => (sum >>> 1) ^ (sum & 1 ? 0xedb88320 : 0), byte));
const crc32 = (bytes: Uint8Array): number => ~bytes.reduce((sum, byte) => (TABLE[(sum ^ byte) & 255] as number) ^ (sum >>> 8), -1) >>> 0;
/** Numbers from the lowest byte to the highest, each in its number of bytes. */
const packed = (sizes: string, ...values: number[]): Uint8Array => Uint8Array.from(values.flatMap((value, place) => Array.from({ length: Number(sizes[place]) }, (_, byte) => (value >>> (8 * byte)) & 255)));

/** The parts of a zip (APPNOTE 6.3.10, 4.3): for each file a header, its name and content; then the directory and its end. */
export function zipped(files: readonly Named<Uint8Array>[]): Uint8Array[] {
  const [parts, directory] = [[] as Uint8Array[], [] as Uint8Array[]];
  let offset = 0;
  for (const [text, content] of files) {
    const name = new TextEncoder().encode(text);
    const runs = PROGRAMS.some((start) => [...start].every((letter, place) => content[place] === letter.charCodeAt(0)));
    const common = packed("2222244422", 20, 0x800, 0, 0, 0x21, crc32(content), content.length, content.length, name.length, 0); // names in UTF-8, of 1980
    parts.push(packed("4", 0x04034b50), common, name, content);
    directory.push(packed("42", 0x02014b50, 0x0314), common, packed("22244", 0, 0, 0, (runs ? 0o100755 : 0o100644) << 16, offset), name);
    offset += 30 + name.length + content.length;
  }
  return [...parts, ...directory, packed("42222442", 0x06054b50, 0, 0, files.length, files.length, directory.reduce((sum, { length }) => sum + length, 0), offset, 0)];
}
