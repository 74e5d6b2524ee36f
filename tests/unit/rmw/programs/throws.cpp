// A middleware that throws, and a node that catches it.
#include <cstdio>
#include <stdexcept>

struct entity { const char *identifier; void *data; const char *name, *ns; void *context; };
extern "C" {
entity *rmw_create_node(void *, const char *, const char *);
entity *rmw_create_subscription(void *, const void *, const char *, const void *, void *);
int rmw_take_with_info(const entity *, void *, bool *, void *, void *);
}
#ifdef MIDDLEWARE
static int data;
static entity one{"rmw_throws", &data, "/in", "/", nullptr};
static entity node{"rmw_throws", &data, "n", "/", nullptr};
entity *rmw_create_node(void *, const char *, const char *) { return &node; }
entity *rmw_create_subscription(void *, const void *, const char *, const void *, void *) { return &one; }
int rmw_take_with_info(const entity *, void *, bool *taken, void *, void *) {
  static int calls;
  *taken = false;
  if (calls++ < 2) throw std::runtime_error("no");
  return 0;
}
#else
int main() {
  int caught = 0;
  char info[256];
  entity *node = rmw_create_node(nullptr, "n", "/");
  entity *in = rmw_create_subscription(node, nullptr, "/in", nullptr, nullptr);
  for (int i = 0; i < 3; i++) {
    bool taken;
    try { rmw_take_with_info(in, nullptr, &taken, info, nullptr); }
    catch (const std::runtime_error &) { caught++; }
  }
  std::printf("caught %d\n", caught);
  std::fflush(stdout);
  std::getchar();
}
#endif
