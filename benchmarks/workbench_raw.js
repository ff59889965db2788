// Asked of the page itself: while it is exchanged for the one to work with, nobody else can look at it.
(() => {
  const look = () => document.querySelector('#waiting polyline')
    ? requestAnimationFrame(() => console.log('raw', performance.timeOrigin + performance.now()))
    : requestAnimationFrame(look);
  look();
})()
