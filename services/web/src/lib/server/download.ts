/** Files that the page makes, and addresses of files that the server makes. */

import { isDark } from "../theme.svelte";

export function download(name: string, content: Blob): void {
  const anchor = document.createElement("a");
  anchor.href = URL.createObjectURL(content);
  anchor.download = name;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(anchor.href), 10_000);
}

/** What a drawing lies on, and is written with, outside of the page. */
export function paper(): { ground: string; ink: string } {
  return isDark() ? { ground: "#1c2026", ink: "#e8ebef" } : { ground: "#ffffff", ink: "#1b2129" };
}

/** A drawing as it is seen, in the size of its view box. */
function standalone(drawing: SVGSVGElement, ground = "none"): string {
  const copy = drawing.cloneNode(true) as SVGSVGElement;
  const box = drawing.viewBox.baseVal;
  const given = { xmlns: "http://www.w3.org/2000/svg", width: String(box.width), height: String(box.height), color: paper().ink, "font-family": "sans-serif" };
  for (const [name, value] of Object.entries(given)) copy.setAttribute(name, value);
  copy.style.colorScheme = isDark() ? "dark" : "light";
  copy.insertAdjacentHTML("afterbegin", `<rect x="${box.x}" y="${box.y}" width="${box.width}" height="${box.height}" fill="${ground}"/>`);
  // No style sheet of the page reaches into the file.
  return new XMLSerializer().serializeToString(copy).replaceAll(/var\((--\w+)\)/g, (_, name: string) => getComputedStyle(drawing).getPropertyValue(name));
}

export function downloadSvg(name: string, drawing: SVGSVGElement): void {
  download(name, new Blob([standalone(drawing, paper().ground)], { type: "image/svg+xml" }));
}

/** At least 1200 pixels wide, so that it can be printed. `layers` lie below the drawing. */
export function downloadPng(name: string, drawing: SVGSVGElement, layers: Iterable<HTMLCanvasElement> = []): void {
  const image = new Image();
  const box = drawing.viewBox.baseVal;
  const scale = Math.max(2, 1200 / box.width);
  const address = URL.createObjectURL(new Blob([standalone(drawing)], { type: "image/svg+xml" }));
  image.onload = () => {
    const canvas = document.createElement("canvas");
    canvas.width = Math.round(box.width * scale);
    canvas.height = Math.round(box.height * scale);
    const pen = canvas.getContext("2d");
    if (!pen) return;
    pen.fillStyle = paper().ground;
    pen.fillRect(0, 0, canvas.width, canvas.height);
    for (const layer of [...layers, image]) pen.drawImage(layer, 0, 0, canvas.width, canvas.height);
    URL.revokeObjectURL(address);
    canvas.toBlob((blob) => blob && download(name, blob));
  };
  image.src = address;
}

/** The address of a table as a file; `where`: conditions on its rows. */
export function tableFile(id: string, table: string, format: string, query: Readonly<Record<string, string>>, where: readonly string[]): string {
  return `/api/v1/campaigns/${id}/${table}?${new URLSearchParams([...Object.entries(query), ...where.map((condition): [string, string] => ["where", condition]), ["format", format]])}`;
}

/** The address of a set as a file for calibration tools; without a rank the best one. */
export function calibrationFile(id: string, format: string, set: Readonly<Record<string, string>> = {}): string {
  return `/api/v1/campaigns/${id}/calibration-file?${new URLSearchParams({ ...set, format })}`;
}
