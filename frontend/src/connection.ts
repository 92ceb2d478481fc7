// Whether the server answers, in words; where it does not take the page's token, a field for another.

import type { Model } from "./wire";
import { button, h, newId } from "./ui/dom";

/** Milliseconds after which a lost server is probably not just slow to come back. */
const PATIENCE_MS = 3000;
const LOST = "The server does not answer. Trying again; what you change is kept.";

/** @param scene what is on the screen, for a server at another address */
export function connectionBox(model: Model, scene: () => Promise<string>) {
  const trouble = h("div", { class: "vlm-trouble", role: "status", hidden: true });
  const id = newId();
  const input = h("input", { type: "text", id, spellcheck: "false", autocomplete: "off", placeholder: "http://127.0.0.1:8080/#token=…" });
  const wrong = h("p", { class: "vlm-wrong", role: "alert" });
  const why = h("p", { role: "alert" });
  const form = h(
    "form", { class: "vlm-ask", hidden: true, onsubmit: (event: Event) => void go(event) },
    why, h("label", { for: id }, "Paste the address that the server printed, or its token"),
    h("div", { class: "vlm-line" }, input, button("Connect", "Go on with this address or token", () => form.requestSubmit())), wrong,
  );
  let timer = 0;

  async function go(event: Event): Promise<void> {
    event.preventDefault();
    wrong.textContent = "";
    const taken = model.renew!(input.value.trim(), await scene());
    wrong.textContent = taken ? "" : "This is neither an address with #token=… nor a token.";
  }

  function ask(words: string): void {
    if (form.hidden && model.renew) form.hidden = false;
    why.textContent = words;
  }

  return {
    trouble,
    form,
    busy(on: boolean): void {
      if (trouble.dataset.state === "lost") return;
      trouble.hidden = !on;
      trouble.textContent = "kernel busy";
    },
    /** @param state "open", "lost" or "refused"; of the latter `reason` says why */
    show(state: string, reason = ""): void {
      const lost = state !== "open";
      trouble.dataset.state = lost ? "lost" : "";
      trouble.hidden = !lost;
      trouble.textContent = state === "refused" ? "not connected" : reason || LOST;
      clearTimeout(timer);
      if (state === "refused") ask(reason);
      else if (!lost) form.hidden = true;
      else if (form.hidden) timer = window.setTimeout(() => ask("The server does not answer: it has ended, or is at another address now."), PATIENCE_MS);
    },
  };
}
