// SPDX-License-Identifier: Apache-2.0
// Copies the extrinsics, and shows a picture over the whole window.
"use strict";
(() => {
  const copy = document.getElementById("copy");

  async function copied(area) {
    try {
      await navigator.clipboard.writeText(area.value);
      return true;
    } catch { // no clipboard without a secure context, or without the reader's leave
      area.hidden = false;
      area.focus();
      area.select();
      return document.execCommand("copy");
    }
  }

  function listenToCopy() {
    const status = copy.querySelector("[role=status]");
    copy.querySelectorAll("[data-copy]").forEach((button) => button.addEventListener("click", async () => {
      const areas = [...copy.querySelectorAll("textarea")];
      const area = areas.find((each) => each.dataset.text === button.dataset.copy);
      areas.forEach((each) => { each.hidden = true; });
      status.textContent = "";
      const done = await copied(area);
      if (done) {
        area.hidden = true;
        button.focus();
      }
      status.textContent = done ? `Copied: ${button.title}.` : "The text is selected. Press Ctrl+C or Cmd+C to copy it.";
    }));
    copy.hidden = false;
  }

  function listenToPictures() {
    const dialog = document.createElement("dialog");
    dialog.className = "enlarged";
    dialog.setAttribute("aria-label", "Enlarged picture");
    const close = document.createElement("button");
    close.type = "button";
    close.textContent = "Close";
    const box = document.createElement("div");
    box.tabIndex = 0;
    const large = document.createElement("img");
    box.append(large);
    dialog.append(close, box);
    document.body.append(dialog);
    close.addEventListener("click", () => dialog.close());
    large.addEventListener("click", () => dialog.close());
    document.querySelectorAll(".enlarge").forEach((button) => button.addEventListener("click", () => {
      const picture = button.querySelector("img");
      large.src = picture.src;
      large.alt = picture.alt;
      dialog.showModal();
    }));
  }

  if (copy) listenToCopy();
  listenToPictures();
})();
