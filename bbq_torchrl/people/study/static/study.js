"use strict";
// A form is sent once: the nonce makes a second one harmless, this makes it unlikely.
for (const form of document.forms) {
  form.addEventListener("submit", (event) => {
    if (form.dataset.sent) event.preventDefault();
    form.dataset.sent = "yes";
  });
}
// A goal card that somebody opened or closed stays so in the pages of the same conversation. On a
// large screen it is open until then.
const card = document.querySelector("details.card");
if (card) {
  const key = `card ${card.dataset.conversation}`;
  try {
    const chosen = sessionStorage.getItem(key);
    card.open = chosen ? chosen === "open" : card.open || innerHeight >= 720;
    card.querySelector("summary").addEventListener("click", () =>
      sessionStorage.setItem(key, card.open ? "closed" : "open"));
  } catch {} // a browser that stores nothing
}
// A page that the back button brings out of the cache can send again.
window.addEventListener("pageshow", (event) => {
  if (event.persisted) window.location.reload();
});
