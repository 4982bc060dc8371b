/** On which sides of a scrolled place more lies: the scrollbar of many systems is hidden until one scrolls. */
export class Overflow {
  before = $state(false);
  after = $state(false);

  watch = (place: HTMLElement): (() => void) => {
    const measure = (): void => void ([this.before, this.after] = [place.scrollLeft > 1, place.scrollLeft + place.clientWidth < place.scrollWidth - 1]);
    const observer = new ResizeObserver(measure);
    for (const part of [place, ...place.children]) observer.observe(part);
    place.addEventListener("scroll", measure, { passive: true });
    return () => {
      observer.disconnect();
      place.removeEventListener("scroll", measure);
    };
  };

  get text(): string {
    const sides = this.before && this.after ? "left and the right" : this.after ? "right" : this.before ? "left" : "";
    return sides && `More columns lie to the ${sides}: scroll the table sideways.`;
  }
}
