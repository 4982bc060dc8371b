/** Sizes a canvas to a width and height in CSS pixels, sharp on dense screens, and returns its empty drawing context. */
export function prepared(canvas: HTMLCanvasElement, width: number, height: number): CanvasRenderingContext2D | null {
  const ratio = Math.min(2, window.devicePixelRatio || 1);
  canvas.width = Math.round(width * ratio);
  canvas.height = height * ratio;
  const pen = canvas.getContext("2d");
  pen?.scale(ratio, ratio);
  return pen;
}
