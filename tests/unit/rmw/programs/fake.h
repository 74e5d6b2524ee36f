/* What a client of the fake middleware asks of it beyond the interface rmw. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

typedef struct { const char *identifier; void *data; const char *name, *ns; void *context; } fake_t;
typedef struct { int64_t source, received; } fake_stamps_t;
typedef struct { const char *identifier; uint8_t data[16]; } fake_gid_t; /* as jazzy has it */
typedef struct {
  fake_stamps_t stamps;
  uint64_t publication, reception;
  fake_gid_t publisher;
  bool from_intra_process;
} fake_info_t;
typedef struct { uint8_t writer[16]; int64_t number; } fake_id_t;
typedef struct { fake_stamps_t stamps; fake_id_t id; } fake_header_t;
typedef struct { void *data; size_t size, capacity; } fake_list_t;
typedef struct { size_t count; void **entities; } fake_set_t;
typedef struct { uint64_t seconds, nanoseconds; } fake_duration_t;
typedef struct { int history; size_t depth; int reliability, durability; } fake_qos_t;
typedef struct {
  void *(*allocate)(size_t, void *);
  void (*deallocate)(void *, void *);
  void *(*reallocate)(void *, size_t, void *);
  void *(*zero_allocate)(size_t, size_t, void *);
  void *state;
} fake_allocator_t;
typedef struct { uint8_t *buffer; size_t length, capacity; fake_allocator_t allocator; } fake_bytes_t;
typedef struct { size_t count; char **texts; fake_allocator_t allocator; } fake_texts_t;
typedef struct {
  const char *node, *ns, *type;
#ifdef HUMBLE
  int kind;
  uint8_t gid[24];
#else
  uint8_t hash[33];
  int kind;
  uint8_t gid[16];
#endif
  struct { fake_qos_t begin; fake_duration_t deadline, lifespan; int liveliness; fake_duration_t lease; bool as_is; } qos;
} fake_end_t;
typedef struct { size_t count; fake_end_t *ends; } fake_ends_t;
typedef struct fake_type {
  const char *identifier;
  const void *data;
  const struct fake_type *(*find)(const struct fake_type *, const char *);
} fake_type_t;
typedef void (*fake_callback_t)(const void *, size_t);
/* Messages and requests: a number, after what actions begin with. */
typedef struct { uint8_t uuid[16]; uint64_t number; } fake_message_t;

/* What begins the GUID of one that has sent something and left. */
#define GONE 99
/* Let something arrive for a subscription or service. */
void fake_arrive(fake_t *entity, const fake_header_t *header, const fake_message_t *message);
/* Numbers of messages that the middleware was given for a publisher, or of responses. */
size_t fake_sent(fake_t *entity, uint64_t *into, size_t most);
void fake_match(fake_t *entity, size_t partners);
/* Let a process of another pod have a server of a service. */
void fake_serve(const char *service, pid_t pid);
/* Let the graph have so many nodes: /robot/node_0 and so on. */
void fake_nodes(size_t number, size_t names);
