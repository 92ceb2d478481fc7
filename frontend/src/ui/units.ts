// The unit of all lengths on the page, chosen beside the scale bar.

import type { Server } from "../server";
import { h, refill } from "./dom";
import { lengthsShownIn, showLengthsIn, unitsFor } from "./format";

export function unitChoice(server: Server, changed: () => void): { element: HTMLElement; update(): void } {
  const element = h("select", { class: "vlm-lengths", "aria-label": "Unit of lengths", title: "Unit of all lengths on this page", onchange: () => (showLengthsIn(server.info!.unit, element.value), changed()) });
  return {
    element,
    update() {
      const { bounds, unit } = server.info!;
      const { names, usual } = unitsFor(Math.max(...bounds.map(([low, high]) => high - low)), unit);
      element.hidden = !names.length;
      if (!names.length) return;
      if (!names.includes(lengthsShownIn(unit))) showLengthsIn(unit, usual);
      refill(element, ...names.map((name) => h("option", { value: name }, name)));
      element.value = lengthsShownIn(unit);
    },
  };
}
