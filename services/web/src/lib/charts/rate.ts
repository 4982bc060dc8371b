/** How fast a counter grows, over the last seconds. */
export class Rate {
  private seen: { at: number; value: number }[] = [];

  constructor(private readonly seconds = 10) {}

  /** Per second; null until a second has been seen. A counter that falls has begun again. */
  at(moment: number, value: number): number | null {
    const last = this.seen.at(-1);
    if (last && value < last.value) this.seen = [];
    this.seen.push({ at: moment, value });
    while (this.seen.length > 2 && (this.seen[1]?.at ?? moment) <= moment - this.seconds) this.seen.shift();
    const first = this.seen[0];
    if (first === undefined || moment - first.at < 1) return null;
    return (value - first.value) / (moment - first.at);
  }
}
