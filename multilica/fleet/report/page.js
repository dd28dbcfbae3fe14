// SPDX-License-Identifier: Apache-2.0
"use strict";
const folds = [...document.querySelectorAll("details.vehicle")];
const button = document.querySelector("#fold");

function unfoldTarget() {
  const target = document.getElementById(location.hash.slice(1));
  const fold = target && target.closest("details");
  if (fold) {
    fold.open = true;
    target.scrollIntoView();
  }
}

function nameButton() {
  button.textContent = folds.every((fold) => fold.open) ? "Fold all" : "Open all";
}

if (button) {
  button.hidden = false;
  button.addEventListener("click", () => {
    const open = !folds.every((fold) => fold.open);
    for (const fold of folds) fold.open = open;
  });
  for (const fold of folds) fold.addEventListener("toggle", nameButton);
  nameButton();
}
addEventListener("hashchange", unfoldTarget);
document.addEventListener("click", (event) => {
  if (event.target.closest('a[href^="#"]')) setTimeout(unfoldTarget); // the same link a second time changes no hash
});
unfoldTarget();
