/** A drag over a chart, which keeps a range of both axes, and of one if it is flat or narrow; a short drag is a click. */

import { scales, type Frame } from "./plot";

type Point = readonly [number, number];
type Range = [number, number];

const SMALL = 4;

export class Drag {
  /** From and to, in pixels. */
  ends = $state.raw<readonly [Point, Point] | null>(null);

  constructor(
    private readonly frame: () => Frame,
    private readonly clicked: (place: Point, event: PointerEvent) => void,
    private readonly kept: (across: Range | null, up: Range | null) => void,
  ) {}

  /** The place of a pointer in pixels of the drawing, within the axes. */
  at(event: PointerEvent): Point {
    const target = event.currentTarget as SVGElement;
    const box = (target.ownerSVGElement ?? target).getBoundingClientRect();
    const { left, right, top, bottom, width, height } = this.frame();
    return [Math.min(width - right, Math.max(left, event.clientX - box.left)), Math.min(height - bottom, Math.max(top, event.clientY - box.top))];
  }

  begin = (event: PointerEvent): void => {
    (event.currentTarget as Element).setPointerCapture(event.pointerId);
    this.ends = [this.at(event), this.at(event)];
  };

  move = (event: PointerEvent): void => {
    if (this.ends !== null) this.ends = [this.ends[0], this.at(event)];
  };

  cancel = (): void => void (this.ends = null);

  end = (event: PointerEvent): void => {
    if (this.ends === null) return;
    const [[ax, ay], [bx, by]] = this.ends;
    this.ends = null;
    const [wide, high] = [Math.abs(ax - bx) >= SMALL, Math.abs(ay - by) >= SMALL];
    const { x, y } = scales(this.frame());
    if (!wide && !high) this.clicked([ax, ay], event);
    else this.kept(wide ? [x(Math.min(ax, bx)), x(Math.max(ax, bx))] : null, high ? [y(Math.max(ay, by)), y(Math.min(ay, by))] : null);
  };

  get box(): { x: number; y: number; width: number; height: number } | null {
    if (this.ends === null) return null;
    const [[ax, ay], [bx, by]] = this.ends;
    return { x: Math.min(ax, bx), y: Math.min(ay, by), width: Math.abs(bx - ax), height: Math.abs(by - ay) };
  }
}
