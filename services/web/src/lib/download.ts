/** Gives the user a file that the page made. */
export function download(name: string, content: Blob): void {
  const anchor = document.createElement("a");
  anchor.href = URL.createObjectURL(content);
  anchor.download = name;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(anchor.href), 10_000);
}

export function downloadCanvas(name: string, canvas: HTMLCanvasElement | null): void {
  canvas?.toBlob((blob) => {
    if (blob) download(name, blob);
  });
}
