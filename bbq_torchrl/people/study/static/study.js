"use strict";
// A form is sent once: the nonce makes a second one harmless, this makes it unlikely.
for (const form of document.forms) {
  form.addEventListener("submit", (event) => {
    if (form.dataset.sent) event.preventDefault();
    form.dataset.sent = "yes";
  });
}
// A goal card that somebody closed stays so in the pages of the same conversation.
const card = document.querySelector("details.card");
if (card) {
  const number = card.dataset.conversation;
  try {
    if (sessionStorage.getItem("closed") === number) card.open = false;
    card.addEventListener("toggle", () => sessionStorage.setItem("closed", card.open ? "" : number));
  } catch {} // a browser that stores nothing
}
// A page that the back button brings out of the cache can send again.
window.addEventListener("pageshow", (event) => {
  if (event.persisted) window.location.reload();
});
