/* A layer between ROS 2 and its middleware, loaded before both into the process of a node.
 *
 * It defines functions of the interface rmw, which every client library of ROS 2 calls, notes what
 * passes, holds back what the mode of its container does not let pass (layer.h), and calls the
 * middleware's own. It never allocates, locks or enters the kernel for a message of a process that
 * works. Without RIGEL_RMW, or if it cannot make its files, everything passes. So it does on another C
 * library than glibc: musl's loader finds all that is used here, but its mutexes have another layout.
 *
 * Declarations are those of ros2/rmw that are the same in all distributions from humble on; nothing
 * of ROS is needed to build it.
 */
#define _GNU_SOURCE
#include "layer.h"

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <link.h>
#include <pthread.h>
#include <semaphore.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#define EXPORT __attribute__((visibility("default")))
#define RET_OK 0
#define RET_ERROR 1
#define RET_TIMEOUT 2
#define RET_UNSUPPORTED 3
#define KEEP_ALL 2
#define TRANSIENT_LOCAL 1

/* ---- What is used of rmw's types --------------------------------------------------------- */

typedef int ret_t;
typedef struct { const char *identifier; void *data; const char *name, *ns; void *context; } node_t;
/* Publishers, subscriptions, services and clients begin in the same way. */
typedef struct { const char *identifier; void *data; const char *name; } entity_t;
typedef struct { int64_t source_timestamp, received_timestamp; } stamps_t;
typedef struct { const char *identifier; uint8_t data[64]; } gid_t_; /* of 16 or 24 bytes there */
typedef struct {
  stamps_t stamps;
  uint64_t publication_number, reception_number;
  gid_t_ publisher; /* a flag follows it there */
} info_t;
typedef struct { uint8_t writer[16]; int64_t number; } request_id_t;
typedef struct { stamps_t stamps; request_id_t id; } request_t;
typedef struct { uint64_t seconds, nanoseconds; } duration_t;
typedef struct { size_t count; void **entities; } entities_t;
typedef struct { int history; size_t depth; int reliability, durability; } qos_t;
typedef struct { void **data; size_t size, capacity; } messages_t;
typedef struct { char *data; size_t size, capacity; } infos_t;
typedef struct {
  void *(*allocate)(size_t, void *);
  void (*deallocate)(void *, void *);
  void *(*reallocate)(void *, size_t, void *);
  void *(*zero_allocate)(size_t, size_t, void *);
  void *state;
} allocator_t;
typedef struct { uint8_t *buffer; size_t length, capacity; allocator_t allocator; } serialized_t;
typedef struct { size_t count; char **texts; allocator_t allocator; } texts_t;
typedef struct { size_t count; char *ends; } ends_t; /* publishers or subscriptions of a topic */
/* Of messages and services alike; what `data` points to begins with a namespace and a name. */
typedef struct type_ {
  const char *identifier;
  const void *data;
  const struct type_ *(*find)(const struct type_ *, const char *);
} type_t;

/* ---- The middleware's functions ------------------------------------------------------------ */

struct library { char names[16][1024]; int count; };

static int note_library(struct dl_phdr_info *info, size_t size, void *into) {
  (void)size;
  struct library *found = into;
  const char *name = info->dlpi_name;
  if (name && (strstr(name, "librmw_") || strstr(name, "/librcl.so")) && found->count < 16 && strlen(name) < 1024)
    strcpy(found->names[found->count++], name);
  return 0;
}

/* Find a function in a library that is loaded. Its handle is kept: the middleware must not go while
 * its functions are known here. */
static void *find_in(const char *library, const char *function) {
  void *handle = dlopen(library, RTLD_NOLOAD | RTLD_LAZY);
  void *found = handle ? dlsym(handle, function) : NULL;
  if (handle && !found) dlclose(handle);
  return found;
}

/* Find a function of the middleware. Python loads ROS with local scope, where RTLD_NEXT finds
 * nothing; upstream's builds have a library that forwards to the chosen middleware. */
static void *find(const char *function) {
  Dl_info from;
  void *found = dlsym(RTLD_NEXT, function);
  if (found && dladdr(found, &from)) find_in(from.dli_fname, function);
  if (found) return found;
  struct library *loaded = calloc(1, sizeof *loaded);
  if (!loaded) return NULL;
  dl_iterate_phdr(note_library, loaded);
  for (int forwarding = 1; forwarding >= 0 && !found; forwarding--)
    for (int i = 0; i < loaded->count && !found; i++)
      if (!!strstr(loaded->names[i], "librmw_implementation.so") == forwarding)
        found = find_in(loaded->names[i], function);
  free(loaded);
  return found;
}

/* The middleware's function of this name, looked for until it is found; NULL if there is none. */
#define REAL(name)                                                            \
  ({                                                                          \
    static _Atomic(void *) cached;                                            \
    void *found_ = atomic_load_explicit(&cached, memory_order_acquire);       \
    if (!found_ && (found_ = find(#name)))                                    \
      atomic_store_explicit(&cached, found_, memory_order_release);           \
    (__typeof__(&name))found_;                                                \
  })
/* What it answers; `otherwise` if there is none. */
#define CALL(name, otherwise, ...)                                            \
  ({                                                                          \
    __typeof__(&name) real_ = REAL(name);                                     \
    real_ ? real_(__VA_ARGS__) : (otherwise);                                 \
  })

/* Only glibc has it. */
extern const char *gnu_get_libc_version(void) __attribute__((weak));

/* Those that are called from here, and not stood before. */
ret_t rmw_get_gid_for_client(const void *client, gid_t_ *gid);
ret_t rmw_get_gid_for_publisher(const void *publisher, gid_t_ *gid);
ret_t rmw_get_node_names(const void *node, texts_t *names, texts_t *spaces);
ret_t rmw_publisher_count_matched_subscriptions(const void *publisher, size_t *number);
ret_t rmw_subscription_count_matched_publishers(const void *subscription, size_t *number);
ret_t rmw_return_loaned_message_from_publisher(const void *publisher, void *message);
ret_t rmw_return_loaned_message_from_subscription(const void *subscription, void *message);
ret_t rmw_get_subscriptions_info_by_topic(const void *node, allocator_t *allocator, const char *topic,
                                          bool as_is, ends_t *found);
ret_t rmw_topic_endpoint_info_array_fini(ends_t *found, allocator_t *allocator);
ret_t rmw_serialize(const void *message, const type_t *type, serialized_t *into);
void rcutils_reset_error(void);
/* Of Cyclone DDS. What they find begins with a GUID. */
int32_t dds_get_guid(int32_t entity, uint8_t *guid);
uint8_t *dds_get_matched_publication_data(int32_t reader, uint64_t publication);
void dds_builtintopic_free_endpoint(uint8_t *found);

/* ---- The files ----------------------------------------------------------------------------- */

/* The middleware may call a node's function from inside a call of ours, which comes back here. */
static pthread_mutex_t mutex = PTHREAD_RECURSIVE_MUTEX_INITIALIZER_NP;
static _Atomic(struct layer_file *) file;
static _Atomic(struct layer_control *) shared;  /* `control`, mapped */
static _Atomic(struct layer_control *) control; /* NULL if all passes: in a helper of ours */
static uint32_t slots_ready;    /* slots that have memory */
static _Atomic int64_t realtime; /* what the clock of timestamps is ahead of now() */
static pthread_key_t thread_ends;
static sem_t wake; /* the thread that watches the mode */

static uint64_t clock_now(clockid_t which) {
  struct timespec t;
  clock_gettime(which, &t);
  return (uint64_t)t.tv_sec * 1000000000ull + (uint64_t)t.tv_nsec;
}

static uint64_t now(void) { return clock_now(CLOCK_MONOTONIC); }

static void compare_clocks(void) {
  int64_t ahead = (int64_t)(clock_now(CLOCK_REALTIME) - now());
  atomic_store_explicit(&realtime, ahead, memory_order_relaxed);
}

/* Make sure that a part of a mapped file has memory: to touch it otherwise kills the process. */
static bool reserve(int fd, size_t from, size_t to) {
  int answer;
  do answer = posix_fallocate(fd, (off_t)from, (off_t)(to - from));
  while (answer == EINTR);
  errno = answer ? answer : errno;
  return !answer;
}

static void *map(int fd, size_t size) {
  void *mapped = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  return mapped == MAP_FAILED ? NULL : mapped;
}

/* Make a file of which the first bytes have memory, and map it. */
static void *make(const char *path, size_t size, size_t ready, mode_t rights) {
  void *mapped = NULL;
  unlink(path);
  int fd = open(path, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, rights);
  if (fd < 0) return NULL;
  if (!fchmod(fd, rights) && !ftruncate(fd, (off_t)size) && reserve(fd, 0, ready))
    mapped = map(fd, size);
  close(fd);
  if (!mapped) unlink(path);
  return mapped;
}

/* Map the container's file `control`; make it if this process is the first. */
static struct layer_control *open_control(const char *directory) {
  char path[1100], made[1150];
  snprintf(path, sizeof path, "%s/control", directory);
  for (int attempt = 0; attempt < 2; attempt++) {
    int fd = open(path, O_RDWR | O_CLOEXEC | O_NOFOLLOW);
    struct stat its;
    if (fd >= 0) {
      struct layer_control *mapped = NULL;
      if (!fstat(fd, &its) && its.st_size >= (off_t)sizeof *mapped) mapped = map(fd, sizeof *mapped);
      close(fd);
      if (mapped && !memcmp(mapped->magic, "rigelctl", 8) && mapped->version == LAYER_VERSION)
        return mapped;
      if (mapped) munmap(mapped, sizeof *mapped);
      errno = EPROTO;
      return NULL;
    }
    snprintf(made, sizeof made, "%s.%d", path, getpid());
    struct layer_control *new = make(made, sizeof *new, sizeof *new, 0666);
    if (!new) return NULL;
    const char *mode = getenv("RIGEL_RMW_MODE");
    atomic_store(&new->mode, mode && !strcmp(mode, "wait") ? LAYER_WAIT : LAYER_WORK);
    new->version = LAYER_VERSION;
    memcpy(new->magic, "rigelctl", 8);
    int linked = link(made, path), because = errno;
    unlink(made);
    if (!linked) return new;
    munmap(new, sizeof *new);
    errno = because;
    if (because != EEXIST) return NULL;
  }
  return NULL;
}

/* Note when this process and its program started, as /proc says it of the first thread: an emulator
 * of another machine, such as QEMU, has a /proc/self/stat of its own, which no other process sees. */
static void note_birth(struct layer_file *own) {
  char text[1024], path[64];
  snprintf(path, sizeof path, "/proc/self/task/%d/stat", getpid());
  FILE *opened = fopen(path, "re");
  if (!opened) return;
  size_t length = fread(text, 1, sizeof text - 1, opened);
  fclose(opened);
  text[length] = 0;
  char *at = strrchr(text, ')');
  for (int field = 2; at && field < 28; field++) {
    at = strchr(at + 1, ' ');
    if (at && field == 21) own->birth = strtoull(at, NULL, 10);
    if (at && field == 27) own->stack = strtoull(at, NULL, 10);
  }
}

static void forget_in_child(void);
static void end_thread(void *slot);
static void stop_watching(void);
static void watch(void);

/* Process 1 of a container has no other way to be ended from inside, if it ignores SIGTERM. */
static void end_at_once(int number) {
  (void)number;
  _exit(128 + SIGKILL);
}

static void let_be_ended(void) {
  struct sigaction now_set;
  if (getpid() == 1 && !sigaction(LAYER_END, NULL, &now_set) && now_set.sa_handler == SIG_DFL)
    signal(LAYER_END, end_at_once);
}

/* The words of rmw.sh. */
#define FOREIGN \
  "its C library does not load ours, which needs glibc 2.17 or newer: set `rmw_layer: false`\n"

/* Say why this process cannot be handed over: to the user, and to the pod's probe. */
static void leave_out(const char *directory) {
  char path[1000];
  snprintf(path, sizeof path, "%s/left-out", directory);
  int fd = open(path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0644);
  if (fd >= 0 && write(fd, FOREIGN, strlen(FOREIGN)) < 0) unlink(path);
  if (fd >= 0) close(fd);
  fprintf(stderr, "rigel-k8s: this process cannot be handed over: " FOREIGN);
}

/* rmw.sh tries so whether the layer can work here: what is written means that it cannot. */
__attribute__((constructor)) static void try_it(void) {
  const char *mode = getenv("RIGEL_RMW_MODE");
  if (!gnu_get_libc_version && mode && !strcmp(mode, "try")) fprintf(stderr, FOREIGN);
}

/* Make the process's file, once; mutex is held. */
static void begin(void) {
  static int tried_by; /* a process that was forked makes a file of its own */
  const char *directory = getenv("RIGEL_RMW");
  if (!directory || !*directory || tried_by == getpid() || strlen(directory) > 900) return;
  if (!gnu_get_libc_version) {
    if (!tried_by && !getenv("RIGEL_K8S_EXEC")) leave_out(directory);
    tried_by = getpid();
    return;
  }
  if (!tried_by) {
    pthread_atfork(NULL, NULL, forget_in_child);
    atexit(stop_watching);
    sem_init(&wake, 0, 0);
    if (pthread_key_create(&thread_ends, end_thread)) return;
  }
  tried_by = getpid();
  compare_clocks();
  char path[1000], made[1100];
  snprintf(path, sizeof path, "%s/%d", directory, tried_by);
  snprintf(made, sizeof made, "%s.new", path);
  struct layer_file *new = NULL;
  struct layer_control *common = atomic_load(&shared);
  if (!common) common = open_control(directory);
  if (common) new = make(made, sizeof *new, offsetof(struct layer_file, slot), 0444);
  if (new) {
    new->version = LAYER_VERSION;
    new->pid = (uint32_t)tried_by;
    note_birth(new);
    new->helper = !!getenv("RIGEL_K8S_EXEC");
    memcpy(new->magic, "rigelrmw", sizeof new->magic);
  }
  if (!new || rename(made, path)) {
    fprintf(stderr, "rigel-k8s: cannot keep notes in %s: %s; this process cannot be handed over\n",
            directory, errno == EPROTO ? "another version of rigel began them" : strerror(errno));
    return; /* what was mapped stays so: this happens once */
  }
  slots_ready = 0;
  atomic_store(&shared, common);
  atomic_store(&control, new->helper ? NULL : common);
  atomic_store(&file, new);
  let_be_ended();
  watch();
}

__attribute__((destructor)) static void end(void) {
  struct layer_file *own = atomic_load(&file);
  if (own) atomic_store(&own->ended, 1);
}

/* ---- Slots, and the entities that have one ------------------------------------------------- */

enum action { NO_ACTION, SEND_GOAL, GET_RESULT, CANCEL_GOAL, GOAL_STATUS, TRANSITION };

/* An entity of the middleware: a node, a publisher, a subscription, a service or a client. It is
 * found by its address, or by what wait sets have for it, in chains that are read without a lock and
 * changed under mutex. */
enum { ENTITY, DATA, ADDRESSES };
typedef void (*announce_t)(const void *, size_t);
struct part {
  const void *address[ADDRESSES];
  _Atomic(struct part *) next[ADDRESSES];
  struct layer_slot *slot; /* NULL if there was none left */
  uint64_t key, name;      /* names it in the workload; of a node: a hash of its name */
  uint64_t alike;          /* the key without telling entities of one name apart */
  uint64_t which;          /* of those */
  enum layer_kind kind;
  enum action action;
  bool always; /* passes in every mode */
  bool warm;   /* is taken while the process waits, for its state */
  bool latched;
  size_t depth;
  int32_t reader; /* Cyclone DDS' own, where a part takes something; else 0 */
  const type_t *type;
  announce_t announce; /* the node's own function for what has arrived, */
  const void *announce_to;
  _Atomic size_t held;   /* and what it was not told of */
  _Atomic int64_t asked; /* of a client: its newest request while the process worked */
  struct part *after;  /* of parts that have left */
};
#define CHAINS 4096
static _Atomic(struct part *) chains[ADDRESSES][CHAINS];
static struct part *gone, **last_gone = &gone; /* oldest first */
static int gone_count;

static size_t chain_of(const void *address) {
  return (size_t)(((uintptr_t)address >> 4) * 0x9E3779B97F4A7C15ull >> 52);
}

static struct part *find_by(int which, const void *address) {
  struct part *one = atomic_load_explicit(&chains[which][chain_of(address)], memory_order_acquire);
  while (one && one->address[which] != address)
    one = atomic_load_explicit(&one->next[which], memory_order_acquire);
  return one;
}

static struct part *find_part(const void *entity) { return find_by(ENTITY, entity); }

#define EACH_PART(one)                                                        \
  for (int chain_ = 0; chain_ < CHAINS; chain_++)                             \
    for (struct part *one = atomic_load(&chains[ENTITY][chain_]); one;        \
         one = atomic_load(&one->next[ENTITY]))

static void chain(struct part *part, int which) {
  _Atomic(struct part *) *first = &chains[which][chain_of(part->address[which])];
  if (!part->address[which]) return;
  atomic_store(&part->next[which], atomic_load(first));
  atomic_store_explicit(first, part, memory_order_release);
}

static void unchain(struct part *part, int which) {
  _Atomic(struct part *) *at = &chains[which][chain_of(part->address[which])];
  while (atomic_load(at) && atomic_load(at) != part) at = &atomic_load(at)->next[which];
  if (atomic_load(at)) atomic_store(at, atomic_load(&part->next[which]));
}

/* Return memory for a part: of one that left long ago, as a reader may still be at a later one. */
static struct part *new_part(void) {
  struct part *part = gone;
  if (gone_count < 256) return calloc(1, sizeof *part);
  gone_count--;
  gone = part->after;
  memset(part, 0, sizeof *part);
  return part;
}

static uint64_t hash(const char *text) {
  uint64_t sum = 0xcbf29ce484222325ull;
  for (; *text; text++) sum = (sum ^ (uint8_t)*text) * 0x100000001b3ull;
  return sum;
}

/* Whether a name is one of those in a list with colons. */
static bool is_in(const char *list, const char *name) {
  size_t length = strlen(name);
  for (const char *at = list; at && *at; at = strchr(at, ':'), at += !!at)
    if (!strncmp(at, name, length) && (!at[length] || at[length] == ':')) return true;
  return false;
}

static bool is_of(const entity_t *entity, const char *middleware) {
  return entity->identifier && strstr(entity->identifier, middleware);
}

/* Cyclone DDS' number for what takes: what an entity points to begins with it, or, of a service,
 * with pointers to its publisher and to its subscription. */
static int32_t reader_of(const entity_t *entity, enum layer_kind kind) {
  void *const *data = entity->data;
  int32_t reader = 0;
  if (data && is_of(entity, "cyclonedds"))
    memcpy(&reader, kind == LAYER_SERVICE ? data[1] : data, sizeof reader);
  return reader;
}

static enum action action_of(enum layer_kind kind, const char *name) {
  const char *at = strstr(name, "/_action/");
  if (!at) return NO_ACTION;
  if (kind == LAYER_PUBLISHER) return strcmp(at, "/_action/status") ? NO_ACTION : GOAL_STATUS;
  if (kind != LAYER_SERVICE) return NO_ACTION;
  if (!strcmp(at, "/_action/send_goal")) return SEND_GOAL;
  if (!strcmp(at, "/_action/get_result")) return GET_RESULT;
  return strcmp(at, "/_action/cancel_goal") ? NO_ACTION : CANCEL_GOAL;
}

/* Give the next block of slots memory; mutex is held. The kernel writes there first: where no memory
 * is left, or the file has been cut off, it answers with an error, and a store would end the node. */
static bool ready_slots(struct layer_file *own) {
  char *at = (char *)&own->slot[slots_ready], *end = (char *)&own->slot[slots_ready + LAYER_BLOCK];
  int zeros = open("/dev/zero", O_RDONLY | O_CLOEXEC);
  while (zeros >= 0 && at < end) {
    ssize_t length = read(zeros, at, (size_t)(end - at));
    if (length > 0) at += length;
    if (length == 0 || (length < 0 && errno != EINTR)) break;
  }
  if (zeros >= 0) close(zeros);
  slots_ready += at == end ? LAYER_BLOCK : 0;
  return at == end;
}

/* Take a free slot; mutex is held. */
static struct layer_slot *take_slot(enum layer_kind kind, const char *name) {
  struct layer_file *own = atomic_load(&file);
  if (!own) return NULL;
  for (uint32_t i = 0; i < LAYER_SLOTS && (i < slots_ready || ready_slots(own)); i++) {
    struct layer_slot *slot = &own->slot[i];
    if (atomic_load(&slot->kind) != LAYER_FREE) continue;
    memset(slot, 0, sizeof *slot);
    slot->node = UINT32_MAX;
    snprintf(slot->name, sizeof slot->name, "%s", name);
    atomic_store(&slot->created, now());
    if (i >= atomic_load(&own->used)) atomic_store(&own->used, i + 1);
    atomic_store_explicit(&slot->kind, kind, memory_order_release);
    return slot;
  }
  atomic_fetch_add(&own->full, 1);
  return NULL;
}

/* Note an entity that was made. */
static struct part *enter(enum layer_kind kind, const void *entity, const char *name,
                          const void *node, const qos_t *qos) {
  pthread_mutex_lock(&mutex);
  begin();
  struct part *owner = node ? find_part(node) : NULL;
  struct part *part = atomic_load(&file) ? new_part() : NULL;
  if (part) {
    part->kind = kind;
    part->name = hash(name);
    part->alike = layer_mix((uint64_t)kind, owner ? owner->name : 0, part->name);
    for (bool taken = true; taken; part->which += taken) {
      taken = false;
      EACH_PART(one) taken |= one->alike == part->alike && one->which == part->which;
    }
    part->key = layer_mix(part->alike, part->which, 0);
    part->action = action_of(kind, name);
    part->always = is_in("/rosout:/parameter_events", name);
    part->warm = is_in("/tf:/tf_static:/clock", name) || is_in(getenv("RIGEL_RMW_WARM"), name);
    part->latched = qos && qos->durability == TRANSIENT_LOCAL;
    part->depth = !qos || !qos->depth ? 1 : qos->history == KEEP_ALL ? 256 : qos->depth;
    part->slot = take_slot(kind, name);
    if (part->slot) {
      part->slot->key = part->key;
      if (owner && owner->slot)
        part->slot->node = (uint32_t)(owner->slot - atomic_load(&file)->slot);
    }
    part->address[ENTITY] = entity;
    if (kind == LAYER_SUBSCRIPTION || kind == LAYER_SERVICE) {
      part->address[DATA] = ((const entity_t *)entity)->data;
      part->reader = reader_of(entity, kind);
    }
    chain(part, ENTITY);
    chain(part, DATA);
  }
  pthread_mutex_unlock(&mutex);
  return part;
}

static void limit_kept(struct part *of, size_t most);
static void end_goals(const struct layer_slot *of);

/* Forget an entity before it goes. */
static void leave(const void *entity) {
  pthread_mutex_lock(&mutex);
  struct part *part = find_part(entity);
  if (part) {
    limit_kept(part, 0);
    unchain(part, ENTITY);
    unchain(part, DATA);
    if (part->slot && part->action == SEND_GOAL) end_goals(part->slot);
    if (part->slot) atomic_store(&part->slot->kind, LAYER_FREE);
    part->after = NULL;
    *last_gone = part;
    last_gone = &part->after;
    gone_count++;
  }
  pthread_mutex_unlock(&mutex);
}

/* ---- What passes --------------------------------------------------------------------------- */

static void note_gap(struct layer_slot *slot, uint64_t at, uint64_t gap) {
  uint64_t window = at / LAYER_WINDOW_NS;
  struct layer_gap *one = &slot->gaps[window % LAYER_WINDOWS];
  if (atomic_load_explicit(&one->window, memory_order_relaxed) != window) {
    atomic_store_explicit(&one->longest, 0, memory_order_relaxed);
    atomic_store_explicit(&one->window, window, memory_order_release);
  }
  uint64_t longest = atomic_load_explicit(&one->longest, memory_order_relaxed);
  while (gap > longest && !atomic_compare_exchange_weak_explicit(
             &one->longest, &longest, gap, memory_order_relaxed, memory_order_relaxed)) {
  }
}

static void add(_Atomic uint64_t *number, uint64_t more) {
  atomic_fetch_add_explicit(number, more, memory_order_relaxed);
}

static void count(struct part *part, ret_t answer, uint64_t messages, uint64_t bytes, uint64_t at) {
  struct layer_slot *slot = part ? part->slot : NULL;
  if (!slot) return;
  if (answer != RET_OK) add(&slot->refused, 1);
  if (answer != RET_OK || !messages) return;
  uint64_t last = atomic_exchange_explicit(&slot->last, at, memory_order_relaxed);
  if (last && at > last) note_gap(slot, at, at - last);
  add(&slot->count, messages);
  if (bytes) add(&slot->bytes, bytes);
}

static void note_age(struct part *part, int64_t sent, uint64_t at) {
  if (!part->slot || sent <= 0) return;
  int64_t age = (int64_t)at + atomic_load_explicit(&realtime, memory_order_relaxed) - sent;
  atomic_store_explicit(&part->slot->age, age > 0 ? (uint64_t)age : 0, memory_order_relaxed);
}

static void note_dropped(struct part *part) {
  if (part->slot) add(&part->slot->dropped, 1);
}

static uint64_t tag_of(uint64_t key, const uint8_t *name) {
  uint64_t two[2];
  memcpy(two, name, sizeof two);
  return layer_mix(key, two[0], two[1]);
}

/* Ask Cyclone DDS for the GUID behind a handle, which is different in each process. */
static bool find_guid(const struct part *part, const uint8_t *handle, uint8_t *into) {
  uint64_t number;
  memcpy(&number, handle, sizeof number);
  uint8_t *found = CALL(dds_get_matched_publication_data, NULL, part->reader, number);
  if (!found) return false; /* who has it has left */
  memcpy(into, found, sizeof(request_id_t){0}.writer);
  CALL(dds_builtintopic_free_endpoint, (void)0, found);
  return true;
}

/* Read a place's name; another thread may give the place to another writer meanwhile. */
static bool read_name(struct layer_writer *place, uint64_t tag, uint8_t *into) {
  uint64_t words[2] = {atomic_load(&place->writer[0]), atomic_load(&place->writer[1])};
  memcpy(into, words, sizeof words);
  return atomic_load(&place->tag) == tag;
}

/* The place of a writer, made if it has none, and what it is called in every process. Two threads
 * may make two places: readers take the larger. */
static struct layer_writer *place_of(struct part *part, const uint8_t *writer, uint8_t *name) {
  enum { BUSY = 1, NEAR = 16 };
  struct layer_file *own = atomic_load_explicit(&file, memory_order_acquire);
  struct layer_writer *oldest = NULL;
  uint64_t silent = UINT64_MAX, there, tag = tag_of(part->key, writer);
  bool is_handle = part->reader && part->kind == LAYER_SUBSCRIPTION;
  memcpy(name, writer, sizeof oldest->writer);
  if (part->reader && !is_handle) memset(name + 8, 0, 8);
  for (size_t n = 0; own && n < NEAR; n++) {
    struct layer_writer *one = &own->writers[((tag >> 20) + n) % LAYER_WRITERS];
    there = atomic_load_explicit(&one->tag, memory_order_acquire);
    if (there == tag && (!is_handle || read_name(one, tag, name))) return one;
    uint64_t last = there ? atomic_load_explicit(&one->last, memory_order_relaxed) : 0;
    if (there != BUSY && last < silent) oldest = one, silent = last;
    if (!there) break;
  }
  if ((is_handle && !find_guid(part, writer, name)) || !oldest) return NULL;
  there = atomic_load(&oldest->tag);
  if (there == BUSY || !atomic_compare_exchange_strong(&oldest->tag, &there, BUSY)) return NULL;
  oldest->key = part->key;
  uint64_t words[2];
  memcpy(words, name, sizeof words);
  atomic_store(&oldest->writer[0], words[0]);
  atomic_store(&oldest->writer[1], words[1]);
  atomic_store(&oldest->taken, 0);
  atomic_store(&oldest->dropped, 0);
  atomic_store_explicit(&oldest->tag, tag, memory_order_release);
  return oldest;
}

/* Note how far a writer has come with what it sends to this process. */
static void note_writer(struct layer_writer *one, uint64_t number, bool passed, uint64_t at) {
  if (!one) return;
  _Atomic uint64_t *newest = passed ? &one->taken : &one->dropped;
  uint64_t before = atomic_load_explicit(newest, memory_order_relaxed);
  while (number > before && !atomic_compare_exchange_weak(newest, &before, number)) {
  }
  atomic_store_explicit(&one->last, at, memory_order_relaxed);
}

/* ---- What a mode lets pass ------------------------------------------------------------------ */

static uint32_t mode_now(void) {
  struct layer_control *common = atomic_load_explicit(&control, memory_order_acquire);
  return common ? atomic_load(&common->mode) : LAYER_WORK;
}

static bool are_goals_held(void) {
  struct layer_control *common = atomic_load_explicit(&control, memory_order_acquire);
  return common && atomic_load(&common->hold_goals);
}

/* How often a process that does not work looks whether its mode has changed, and one that works and
 * has nothing to do counts its partners. */
#define IDLE_NS 1000000000ull
static uint64_t step_of(uint32_t mode, bool goals) {
  if (mode == LAYER_HOLD || mode == LAYER_FINISH) return 2000000ull;
  return mode != LAYER_WORK || goals ? 20000000ull : IDLE_NS;
}

/* When this thread has begun what it does, while the process worked; 0 if it has not. Threads of a
 * pool take, run the node's callback, and do not say when it ends: what they publish counts as the
 * callback's until they begin something else, but not for ever. */
static __thread uint64_t begun __attribute__((tls_model("initial-exec")));
static __thread struct layer_slot *own_turns __attribute__((tls_model("initial-exec")));
#define BEGUN_NS 10000000000ull

/* Whether this thread works, or finishes what it began when the process worked. */
static bool is_working(void) {
  uint32_t mode = mode_now();
  if (mode == LAYER_WORK || mode == LAYER_FINISH) return true;
  return mode == LAYER_STOP && begun && now() - begun < BEGUN_NS;
}

/* Whether a message that is to be published stays here. */
static bool is_muted(const struct part *part) { return part && !part->always && !is_working(); }

/* Whether what arrives for a part stays in the middleware's queue. */
static bool is_held(const struct part *part, uint32_t mode, bool goals) {
  if (part->kind != LAYER_SUBSCRIPTION && part->kind != LAYER_SERVICE) return false;
  if (part->action == SEND_GOAL && goals) return true;
  if (mode < LAYER_HOLD) return false;
  if (mode == LAYER_HOLD) return !part->warm && !part->latched;
  return mode == LAYER_FINISH || (part->action != GET_RESULT && part->action != CANCEL_GOAL);
}

static void note_turn(void);
static void hold_back(struct part *part, size_t number);
static __thread bool takes __attribute__((tls_model("initial-exec")));

static void end_taking(void) {
  struct layer_file *own = atomic_load_explicit(&file, memory_order_acquire);
  if (takes && own) atomic_fetch_sub(&own->taking, 1);
  takes = false;
}

/* Begin to take something, and return the mode in which it is done, or REFUSED; `end_taking`
 * follows. A keeper that sets the mode and then sees no thread taking knows all that was taken. An
 * exception of the middleware skips `end_taking`, so the thread's next taking makes up for it. */
#define REFUSED UINT32_MAX
static uint32_t begin_taking(struct part *part) {
  struct layer_file *own = atomic_load_explicit(&file, memory_order_acquire);
  if (!own || !part) return LAYER_WORK;
  if (!takes) atomic_fetch_add(&own->taking, 1);
  takes = true;
  uint32_t mode = mode_now();
  if (part->announce) note_turn();
  if (!is_held(part, mode, are_goals_held())) return mode;
  end_taking();
  if (part->announce) hold_back(part, 1);
  return REFUSED;
}

/* Whether the process before this one has taken what has this name and number. */
static bool was_taken(uint64_t key, const uint8_t *name, uint64_t number) {
  struct layer_control *common = atomic_load_explicit(&control, memory_order_acquire);
  if (!common || !atomic_load_explicit(&common->drop_count, memory_order_acquire)) return false;
  uint64_t tag = tag_of(key, name);
  for (size_t n = 0; n < LAYER_DROPS; n++) {
    const struct layer_drop *one = &common->drop[((tag >> 20) + n) % LAYER_DROPS];
    if (!one->tag) return false;
    if (one->tag == tag) return number <= one->number;
  }
  return false;
}

/* Whether a message that was taken is handed to the node. */
static bool passes(struct part *part, uint32_t mode, const info_t *info, uint64_t at) {
  if (part->always || part->warm || part->latched) return true;
  bool passed = mode == LAYER_WORK;
  if (info) {
    uint64_t number = info->publication_number;
    if (!number || number == UINT64_MAX) number = (uint64_t)info->stamps.source_timestamp;
    uint8_t name[sizeof(request_id_t){0}.writer];
    struct layer_writer *place = place_of(part, info->publisher.data, name);
    passed = passed && !was_taken(part->key, name, number);
    note_writer(place, number, passed, at);
  }
  if (!passed) note_dropped(part);
  return passed;
}

static bool is_among(struct layer_friend *all, const uint8_t *writer) {
  for (struct layer_friend *one = all; one < all + LAYER_FRIENDS; one++)
    if (atomic_load(&one->pid) && !memcmp(writer, one->prefix, sizeof one->prefix)) return true;
  return false;
}

/* Whether a request comes from a process of this container. */
static bool is_of_friend(const uint8_t *writer) {
  struct layer_control *common = atomic_load(&shared);
  return common && is_among(common->friends, writer);
}

/* Whether there are other pods of the workload, and whether a request comes from one of them, where
 * it is answered. */
static bool has_others(void) {
  struct layer_control *common = atomic_load(&shared);
  return common && atomic_load(&common->others[0].pid);
}

static bool is_of_other(const uint8_t *writer) {
  return has_others() && is_among(atomic_load(&shared)->others, writer);
}

/* Note for the container's other processes how the identifiers of this one's entities begin, from
 * any publisher; those of zenoh have nothing in common, so each client is noted there. */
static void become_friend(const entity_t *entity, enum layer_kind kind) {
  struct layer_control *common = atomic_load(&shared);
  gid_t_ gid = {0};
  ret_t answer = RET_UNSUPPORTED;
  if (kind != (is_of(entity, "zenoh") ? LAYER_CLIENT : LAYER_PUBLISHER)) return;
  if (kind == LAYER_CLIENT)
    answer = CALL(rmw_get_gid_for_client, answer, entity, &gid);
  else if (is_of(entity, "cyclonedds"))
    answer = CALL(dds_get_guid, answer, *(int32_t *)entity->data, gid.data);
  else
    answer = CALL(rmw_get_gid_for_publisher, answer, entity, &gid);
  if (!common || answer != RET_OK || is_of_friend(gid.data)) return;
  for (int i = 0; i < LAYER_FRIENDS; i++) {
    struct layer_friend *one = &common->friends[i];
    uint32_t pid = atomic_load(&one->pid);
    bool gone = pid && kill((pid_t)pid, 0) && errno == ESRCH;
    if ((pid && !gone) || !atomic_compare_exchange_strong(&one->pid, &pid, (uint32_t)getpid()))
      continue;
    atomic_store(&one->known, 0);
    memcpy(one->prefix, gid.data, sizeof one->prefix);
    return;
  }
}

/* ---- Goals of actions ----------------------------------------------------------------------- */

/* A client's request for a goal begins with the goal's UUID, as those for its result and its end. */
static void ask_goal(const struct part *service, const request_t *header, const uint8_t *uuid) {
  struct layer_file *own = atomic_load(&file);
  if (!own || !service->slot) return;
  uint32_t from = atomic_fetch_add(&own->goals, 1);
  for (uint32_t n = 0; n < LAYER_GOAL_COUNT; n++) {
    struct layer_goal *goal = &own->goal[(from + n) % LAYER_GOAL_COUNT];
    uint32_t state = atomic_load(&goal->state);
    if (state != LAYER_NO_GOAL && state != LAYER_ENDED) continue;
    if (!atomic_compare_exchange_strong(&goal->state, &state, LAYER_CLAIMED)) continue;
    goal->service = (uint32_t)(service->slot - own->slot);
    memcpy(goal->uuid, uuid, sizeof goal->uuid);
    memcpy(goal->client, header->id.writer, sizeof goal->client);
    goal->number = header->id.number;
    atomic_store_explicit(&goal->state, LAYER_ASKED, memory_order_release);
    return;
  }
}

/* The response to the request for a goal begins with whether it was accepted. */
static void answer_goal(const request_id_t *id, const uint8_t *accepted) {
  struct layer_file *own = atomic_load(&file);
  for (int i = 0; own && i < LAYER_GOAL_COUNT; i++) {
    struct layer_goal *goal = &own->goal[i];
    uint32_t asked = LAYER_ASKED;
    if (atomic_load_explicit(&goal->state, memory_order_acquire) == LAYER_ASKED &&
        goal->number == id->number && !memcmp(goal->client, id->writer, sizeof goal->client))
      atomic_compare_exchange_strong(&goal->state, &asked, *accepted ? LAYER_OPEN : LAYER_NO_GOAL);
  }
}

static struct layer_goal *find_goal(const uint8_t *uuid) {
  struct layer_file *own = atomic_load(&file);
  for (int i = 0; own && i < LAYER_GOAL_COUNT; i++) {
    struct layer_goal *goal = &own->goal[i];
    if (atomic_load_explicit(&goal->state, memory_order_acquire) >= LAYER_ASKED &&
        !memcmp(goal->uuid, uuid, sizeof goal->uuid))
      return goal;
  }
  return NULL;
}

/* Note which goals have ended, from what an action server publishes of them: action_msgs'
 * GoalStatusArray, a sequence of C (data, size) or a vector of C++ (begin, end). */
static void note_goals(const void *message) {
  struct status { uint8_t uuid[16]; int32_t seconds; uint32_t nanoseconds; int8_t status; };
  struct { struct status *begin; uintptr_t second; } list;
  enum { SUCCEEDED = 4 };
  memcpy(&list, message, sizeof list);
  uintptr_t first = (uintptr_t)list.begin;
  if (!first) return;
  size_t number = list.second < first ? list.second : (list.second - first) / sizeof *list.begin;
  for (size_t i = 0; i < number; i++) {
    if (list.begin[i].status < SUCCEEDED) continue;
    struct layer_goal *goal = find_goal(list.begin[i].uuid);
    if (goal) atomic_store(&goal->state, LAYER_ENDED);
  }
}

/* Note the state that a lifecycle node comes into: its own library says so, always in C. */
static void note_transition(struct layer_slot *slot, const void *message) {
  struct state { uint8_t id; struct { char *data; size_t size, capacity; } label; };
  const struct { uint64_t time; struct state transition, start, goal; } *event = message;
  atomic_store(&slot->answers, event->goal.id);
}

/* End the goals of a service that goes. */
static void end_goals(const struct layer_slot *of) {
  struct layer_file *own = atomic_load(&file);
  for (int i = 0; own && i < LAYER_GOAL_COUNT; i++) {
    struct layer_goal *goal = &own->goal[i];
    if (atomic_load(&goal->state) >= LAYER_ASKED && &own->slot[goal->service] == of)
      atomic_store(&goal->state, LAYER_ENDED);
  }
}

/* ---- Latched messages that wait until the process works ------------------------------------- */

/* In the order in which they were published; guarded by mutex. */
static struct kept { struct kept *next; struct part *part; serialized_t message; } *kept;
static _Atomic int kept_waits;

static void *allocate(size_t size, void *state) { (void)state; return malloc(size); }
static void deallocate(void *memory, void *state) { (void)state; free(memory); }
static void *reallocate(void *memory, size_t size, void *state) {
  (void)state;
  return realloc(memory, size);
}
static void *zero_allocate(size_t number, size_t size, void *state) {
  (void)state;
  return calloc(number, size);
}

/* Forget the oldest messages of a part until `most` are left; mutex is held. */
static void limit_kept(struct part *of, size_t most) {
  size_t number = 0;
  for (struct kept *one = kept; one; one = one->next) number += one->part == of;
  for (struct kept **at = &kept; *at && number > most;) {
    struct kept *one = *at;
    if (one->part != of) {
      at = &one->next;
      continue;
    }
    *at = one->next;
    free(one->message.buffer);
    free(one);
    number--;
  }
}

/* Keep a latched message that may not be sent now: `message`, or `serialized`. What a process that
 * stopped publishes goes out if it works again. */
static void keep(struct part *part, const void *message, const serialized_t *serialized) {
  serialized_t copy = {NULL, 0, 0, {allocate, deallocate, reallocate, zero_allocate, NULL}};
  bool copied = false;
  if (part->latched && serialized && (copy.buffer = malloc(serialized->length + 1))) {
    memcpy(copy.buffer, serialized->buffer, serialized->length);
    copy.length = copy.capacity = serialized->length;
    copied = true;
  } else if (part->latched && message && part->type) {
    copied = CALL(rmw_serialize, RET_UNSUPPORTED, message, part->type, &copy) == RET_OK;
  }
  struct kept *new = copied ? malloc(sizeof *new) : NULL;
  if (!new) {
    free(copy.buffer);
    note_dropped(part);
    return;
  }
  *new = (struct kept){NULL, part, copy};
  pthread_mutex_lock(&mutex);
  struct kept **at = &kept;
  while (*at) at = &(*at)->next;
  *at = new;
  limit_kept(part, part->depth);
  atomic_store(&kept_waits, 1);
  pthread_mutex_unlock(&mutex);
  watch();
}

EXPORT ret_t rmw_publish_serialized_message(const void *, const serialized_t *, void *);

/* Send what was kept, as soon as the process works. */
static void give_out(void) {
  if (!atomic_load_explicit(&kept_waits, memory_order_relaxed) || mode_now() != LAYER_WORK) return;
  pthread_mutex_lock(&mutex);
  atomic_store(&kept_waits, 0);
  for (struct kept *one; (one = kept);) {
    kept = one->next;
    ret_t answer = rmw_publish_serialized_message(one->part->address[ENTITY], &one->message, NULL);
    if (answer != RET_OK)
      fprintf(stderr, "rigel-k8s: a latched message of %s cannot be sent: error %d\n",
              one->part->slot ? one->part->slot->name : "a publisher", answer);
    free(one->message.buffer);
    free(one);
  }
  pthread_mutex_unlock(&mutex);
}

/* ---- Nodes and their entities -------------------------------------------------------------- */

EXPORT void *rmw_create_node(void *context, const char *name, const char *ns) {
  __typeof__(&rmw_create_node) real = REAL(rmw_create_node);
  node_t *made = real ? real(context, name, ns) : NULL;
  if (made) {
    char full[LAYER_NAME];
    bool root = !ns || !*ns || !strcmp(ns, "/");
    snprintf(full, sizeof full, "%s/%s", root ? "" : ns, name ? name : "");
    enter(LAYER_NODE, made, full, NULL, NULL);
    struct layer_file *own = atomic_load(&file);
    if (own && !*own->middleware && made->identifier)
      snprintf(own->middleware, sizeof own->middleware, "%s", made->identifier);
  }
  return made;
}

EXPORT ret_t rmw_destroy_node(void *node) {
  __typeof__(&rmw_destroy_node) real = REAL(rmw_destroy_node);
  leave(node);
  return real ? real(node) : RET_ERROR;
}

/* Note the type of an entity: its name is in what the middleware itself reads of it. */
static void note_type(struct part *part, const type_t *type) {
  part->type = type;
  if (!part->slot || !type || !type->identifier || !type->find) return;
  const char *language = strstr(type->identifier, "cpp") ? "cpp" : "c";
  bool by_members = strstr(atomic_load(&file)->middleware, "cyclone") != NULL;
  for (int i = 0; i < 2; i++) {
    char dialect[64];
    snprintf(dialect, sizeof dialect, "rosidl_typesupport_%s_%s",
             by_members == !i ? "introspection" : "fastrtps", language);
    const type_t *found = type->find(type, dialect);
    const char *const *names = found ? found->data : NULL;
    if (!names || !names[0] || !names[1]) continue;
    char text[2 * LAYER_TYPE], *to = part->slot->type;
    snprintf(text, sizeof text, "%s::%s", names[0], names[1]);
    for (const char *at = text; *at && to < part->slot->type + LAYER_TYPE - 1; at++) {
      bool parts = !strncmp(at, "::", 2) || !strncmp(at, "__", 2);
      *to++ = parts ? '/' : *at;
      at += parts;
    }
    bool moves = !language[1] && !strcmp(part->slot->type, "lifecycle_msgs/msg/TransitionEvent");
    if (moves && part->kind == LAYER_PUBLISHER) part->action = TRANSITION;
    return;
  }
  __typeof__(&rcutils_reset_error) reset = REAL(rcutils_reset_error);
  if (reset) reset();
}

#define CREATE(function, kind, more, ...)                                                          \
  EXPORT void *function(void *node, const type_t *type, const char *name, const qos_t *qos more) { \
    __typeof__(&function) real = REAL(function);                                                   \
    entity_t *made = real ? real(node, type, name, qos __VA_ARGS__) : NULL;                        \
    struct part *part = made ? enter(kind, made, made->name ? made->name : "", node, qos) : NULL;  \
    if (part) note_type(part, type);                                                               \
    if (part) become_friend(made, kind);                                                           \
    return made;                                                                                   \
  }
#define COMMA ,
CREATE(rmw_create_publisher, LAYER_PUBLISHER, COMMA void *options, COMMA options)
CREATE(rmw_create_subscription, LAYER_SUBSCRIPTION, COMMA void *options, COMMA options)
CREATE(rmw_create_service, LAYER_SERVICE, )
CREATE(rmw_create_client, LAYER_CLIENT, )

#define DESTROY(function)                              \
  EXPORT ret_t function(void *node, void *entity) {    \
    __typeof__(&function) real = REAL(function);       \
    leave(entity);                                     \
    return real ? real(node, entity) : RET_ERROR;      \
  }
DESTROY(rmw_destroy_publisher)
DESTROY(rmw_destroy_subscription)
DESTROY(rmw_destroy_service)
DESTROY(rmw_destroy_client)

/* ---- Messages ------------------------------------------------------------------------------ */

EXPORT ret_t rmw_publish(const void *publisher, const void *message, void *allocation) {
  struct part *part = find_part(publisher);
  if (part && part->action == GOAL_STATUS && message) note_goals(message);
  if (part && part->action == TRANSITION && message) note_transition(part->slot, message);
  if (is_muted(part)) return keep(part, message, NULL), RET_OK;
  give_out();
  ret_t answer = CALL(rmw_publish, RET_ERROR, publisher, message, allocation);
  count(part, answer, 1, 0, now());
  return answer;
}

EXPORT ret_t rmw_publish_loaned_message(const void *publisher, void *message, void *allocation) {
  struct part *part = find_part(publisher);
  if (is_muted(part)) {
    keep(part, message, NULL);
    return CALL(rmw_return_loaned_message_from_publisher, RET_UNSUPPORTED, publisher, message);
  }
  give_out();
  ret_t answer = CALL(rmw_publish_loaned_message, RET_UNSUPPORTED, publisher, message, allocation);
  count(part, answer, 1, 0, now());
  return answer;
}

EXPORT ret_t rmw_publish_serialized_message(const void *publisher, const serialized_t *message,
                                            void *allocation) {
  struct part *part = find_part(publisher);
  if (is_muted(part)) return keep(part, NULL, message), RET_OK;
  give_out();
  ret_t answer = CALL(rmw_publish_serialized_message, RET_ERROR, publisher, message, allocation);
  count(part, answer, 1, message ? message->length : 0, now());
  return answer;
}

/* Count what was taken at a time and given to the node, and end the taking. */
static void close_taking(struct part *part, uint32_t mode, ret_t answer, size_t taken, uint64_t at) {
  count(part, answer, taken, 0, at);
  if (taken && mode == LAYER_WORK) begun = at;
  if (taken && own_turns) atomic_store_explicit(&own_turns->age, at, memory_order_relaxed);
  end_taking();
}

/* End a taking: hide from the node what its mode does not let pass. */
static ret_t hand_over(struct part *part, uint32_t mode, ret_t answer, bool *taken,
                       const info_t *info, void **loan) {
  bool arrived = answer == RET_OK && taken && *taken;
  uint64_t at = arrived ? now() : 0;
  if (part && arrived && !passes(part, mode, info, at)) {
    if (loan)
      CALL(rmw_return_loaned_message_from_subscription, RET_OK, part->address[ENTITY], *loan);
    *taken = arrived = false;
  }
  if (part && arrived && info) note_age(part, info->stamps.source_timestamp, at);
  close_taking(part, mode, answer, arrived, at);
  return answer;
}

static ret_t leave_it(bool *taken) {
  if (taken) *taken = false;
  return RET_OK;
}

/* A function that takes with information of the message, and one that takes without, which is
 * replaced by the other where there is one. */
#define TAKE(function, with_info, message_t, loan)                                             \
  EXPORT ret_t with_info(const void *subscription, message_t message, bool *taken,             \
                         info_t *info, void *allocation) {                                     \
    __typeof__(&with_info) real = REAL(with_info);                                             \
    struct part *part = find_part(subscription);                                               \
    uint32_t mode = begin_taking(part);                                                        \
    if (mode == REFUSED) return leave_it(taken);                                               \
    ret_t answer =                                                                             \
        real ? real(subscription, message, taken, info, allocation) : RET_UNSUPPORTED;         \
    return hand_over(part, mode, answer, taken, info, loan);                                   \
  }                                                                                            \
  EXPORT ret_t function(const void *subscription, message_t message, bool *taken,              \
                        void *allocation) {                                                    \
    info_t info = {0};                                                                         \
    if (REAL(with_info)) return with_info(subscription, message, taken, &info, allocation);    \
    __typeof__(&function) real = REAL(function);                                               \
    struct part *part = find_part(subscription);                                               \
    uint32_t mode = begin_taking(part);                                                        \
    if (mode == REFUSED) return leave_it(taken);                                               \
    ret_t answer = real ? real(subscription, message, taken, allocation) : RET_UNSUPPORTED;    \
    return hand_over(part, mode, answer, taken, NULL, loan);                                   \
  }
TAKE(rmw_take, rmw_take_with_info, void *, NULL)
TAKE(rmw_take_serialized_message, rmw_take_serialized_message_with_info, serialized_t *, NULL)
TAKE(rmw_take_loaned_message, rmw_take_loaned_message_with_info, void **, message)
TAKE(rmw_take_dynamic_message, rmw_take_dynamic_message_with_info, void *, NULL)

/* Several at once: those that pass come first then. In humble, which has no dynamic messages, an
 * info_t is longer. */
EXPORT ret_t rmw_take_sequence(const void *subscription, size_t most, messages_t *messages,
                               infos_t *infos, size_t *taken, void *allocation) {
  struct part *part = find_part(subscription);
  uint32_t mode = begin_taking(part);
  if (mode == REFUSED) {
    if (taken) *taken = 0;
    return RET_OK;
  }
  ret_t answer = CALL(rmw_take_sequence, RET_UNSUPPORTED, subscription, most, messages, infos, taken,
                      allocation);
  size_t arrived = answer == RET_OK && taken ? *taken : 0, passed = 0;
  uint64_t at = arrived ? now() : 0;
  size_t size = offsetof(info_t, publisher.data) + (REAL(rmw_take_dynamic_message) ? 16 : 24) + 8;
  for (size_t i = 0; part && i < arrived; i++) {
    const info_t *info = (const info_t *)(infos->data + i * size);
    if (!passes(part, mode, info, at)) continue;
    void *message = messages->data[i];
    messages->data[i] = messages->data[passed];
    messages->data[passed] = message;
    note_age(part, info->stamps.source_timestamp, at);
    memmove(infos->data + passed++ * size, info, size);
  }
  if (part && arrived) *taken = messages->size = infos->size = passed;
  close_taking(part, mode, answer, part ? passed : arrived, at);
  return answer;
}

/* ---- Requests ------------------------------------------------------------------------------ */

EXPORT ret_t rmw_send_request(const void *client, const void *request, int64_t *sequence) {
  ret_t answer = CALL(rmw_send_request, RET_ERROR, client, request, sequence);
  struct part *part = find_part(client);
  count(part, answer, 1, 0, now());
  if (part && answer == RET_OK && sequence && is_working()) atomic_store(&part->asked, *sequence);
  return answer;
}

static void count_answer(struct part *part, bool passed) {
  if (part && part->slot && passed) add(&part->slot->answers, 1);
}

/* What goes on with a response was begun with its request. */
EXPORT ret_t rmw_take_response(const void *client, request_t *header, void *response, bool *taken) {
  ret_t answer = CALL(rmw_take_response, RET_ERROR, client, header, response, taken);
  struct part *part = find_part(client);
  bool arrived = answer == RET_OK && taken && *taken;
  count_answer(part, arrived);
  if (part && arrived && header->id.number <= atomic_load(&part->asked)) begun = now();
  return answer;
}

/* Whether a request that was taken is handed to the node. */
static bool admits(struct part *part, uint32_t mode, const request_t *header, const void *request,
                   uint64_t at) {
  uint64_t number = (uint64_t)header->id.number;
  uint8_t name[sizeof header->id.writer], guid[sizeof header->id.writer];
  struct layer_writer *place = place_of(part, header->id.writer, name);
  const uint8_t *sender = header->id.writer;
  bool asks = part->reader && (mode == LAYER_WAIT || has_others());
  if (asks && find_guid(part, sender + 8, guid)) sender = guid;
  bool passed = mode == LAYER_WORK || (mode == LAYER_WAIT && is_of_friend(sender));
  if (part->action == GET_RESULT || part->action == CANCEL_GOAL) {
    if (mode == LAYER_STOP) passed = !!find_goal(request);
    passed = passed && !was_taken(LAYER_GOALS, request, 0);
  }
  passed = passed && !is_of_other(sender) && !was_taken(part->key, name, number);
  note_writer(place, number, passed, at);
  if (passed && part->action == SEND_GOAL) ask_goal(part, header, request);
  if (!passed) note_dropped(part);
  return passed;
}

EXPORT ret_t rmw_take_request(const void *service, request_t *header, void *request, bool *taken) {
  struct part *part = find_part(service);
  uint32_t mode = begin_taking(part);
  if (mode == REFUSED) return leave_it(taken);
  ret_t answer = CALL(rmw_take_request, RET_ERROR, service, header, request, taken);
  bool arrived = answer == RET_OK && taken && *taken;
  uint64_t at = arrived ? now() : 0;
  if (part && arrived && !admits(part, mode, header, request, at)) *taken = arrived = false;
  close_taking(part, mode, answer, arrived, at);
  return answer;
}

EXPORT ret_t rmw_send_response(const void *service, request_id_t *id, void *response) {
  ret_t answer = CALL(rmw_send_response, RET_ERROR, service, id, response);
  struct part *part = find_part(service);
  if (part && part->action == SEND_GOAL) answer_goal(id, response);
  count_answer(part, true); /* one that cannot be sent is not open any more, either */
  return answer;
}

/* Whether the workload's other pods drop what this process requests. */
static bool is_known(struct layer_control *common) {
  uint32_t own = (uint32_t)getpid();
  for (struct layer_friend *one = common->friends; one < common->friends + LAYER_FRIENDS; one++)
    if (atomic_load(&one->pid) == own && !atomic_load(&one->known)) return false;
  return true;
}

/* Whether a service has a server outside of the workload's other pods, which drop what this pod
 * requests. While the process waits there is such a pod: until they know each other, the answer is
 * no, since a server there would answer. */
static bool is_server_here(const void *node, const char *service) {
  struct layer_control *common = atomic_load_explicit(&control, memory_order_acquire);
  if (!common || !service) return true;
  if (!has_others()) return mode_now() != LAYER_WAIT;
  if (!is_known(common)) return false;
  allocator_t memory = {allocate, deallocate, reallocate, zero_allocate, NULL};
  char topic[LAYER_NAME + 16];
  ends_t found = {0};
  snprintf(topic, sizeof topic, "rq%sRequest", service); /* as DDS knows it */
  ret_t answer =
      CALL(rmw_get_subscriptions_info_by_topic, RET_UNSUPPORTED, node, &memory, topic, true, &found);
  bool here = answer != RET_OK || !found.count; /* not known: zenoh */
  /* Three texts, from iron on a hash, which kind; then the identifier and the quality of service. */
  bool old = !REAL(rmw_take_dynamic_message);
  size_t at = old ? 28 : 64, size = old ? 144 : 168;
  for (size_t i = 0; i < found.count; i++)
    here |= !is_of_other((const uint8_t *)found.ends + i * size + at);
  if (answer == RET_OK) CALL(rmw_topic_endpoint_info_array_fini, RET_OK, &found, &memory);
  return here;
}

EXPORT ret_t rmw_service_server_is_available(const void *node, const void *client, bool *available) {
  ret_t answer = CALL(rmw_service_server_is_available, RET_ERROR, node, client, available);
  if (answer == RET_OK && available && *available)
    *available = is_server_here(node, ((const entity_t *)client)->name);
  return answer;
}

EXPORT ret_t rmw_count_services(const void *node, const char *service, size_t *count) {
  ret_t answer = CALL(rmw_count_services, RET_UNSUPPORTED, node, service, count);
  if (answer == RET_OK && count && *count && !is_server_here(node, service)) *count = 0;
  return answer;
}

/* ---- Executors that are called when something arrives --------------------------------------- */

/* They do not call rmw_wait: what they take is their heartbeat. */
static _Atomic(struct layer_slot *) events;

static void note_turn(void) {
  struct layer_slot *slot = atomic_load_explicit(&events, memory_order_acquire);
  if (!slot) return;
  atomic_store_explicit(&slot->last, now(), memory_order_relaxed);
  add(&slot->count, 1);
}

/* Note that a node is to be told of something when its mode lets it pass. */
static void hold_back(struct part *part, size_t number) {
  atomic_fetch_add(&part->held, number);
  watch();
}

static void on_arrival(const void *of, size_t number) {
  struct part *part = (struct part *)of;
  if (is_held(part, mode_now(), are_goals_held()))
    hold_back(part, number);
  else
    part->announce(part->announce_to, number);
}

#define ANNOUNCE(function)                                                                     \
  EXPORT ret_t function(void *entity, announce_t announce, const void *to) {                   \
    __typeof__(&function) real = REAL(function);                                               \
    if (!real) return RET_UNSUPPORTED;                                                         \
    if (!atomic_load(&file)) return real(entity, announce, to); /* it calls from in there */   \
    pthread_mutex_lock(&mutex);                                                                \
    struct part *part = find_part(entity);                                                     \
    ret_t answer = part ? real(entity, NULL, NULL) : RET_OK;                                   \
    if (part && !atomic_load(&events)) begin_events();                                         \
    if (part) part->announce = announce, part->announce_to = to;                               \
    if (part && announce) announce = on_arrival, to = part;                                    \
    if (answer == RET_OK && (announce || !part)) answer = real(entity, announce, to);          \
    pthread_mutex_unlock(&mutex);                                                              \
    return answer;                                                                             \
  }
static void begin_events(void) {
  struct layer_slot *slot = take_slot(LAYER_EXECUTOR, "");
  if (slot) atomic_store(&slot->waiting, LAYER_UNKNOWN);
  atomic_store(&events, slot);
}
ANNOUNCE(rmw_subscription_set_on_new_message_callback)
ANNOUNCE(rmw_service_set_on_new_request_callback)

/* Tell nodes of what was held back and may pass now; return whether something is left. */
static bool tell(void) {
  bool left = false;
  pthread_mutex_lock(&mutex);
  EACH_PART(one) {
    bool is = is_held(one, mode_now(), are_goals_held());
    size_t number = is ? atomic_load(&one->held) : atomic_exchange(&one->held, 0);
    if (!is && number && one->announce) one->announce(one->announce_to, number);
    left |= is && number;
  }
  pthread_mutex_unlock(&mutex);
  return left;
}

static void count_partners(uint64_t at);
static _Atomic bool watched, ends, has_waited; /* has_waited: whether a thread calls rmw_wait */

static bool is_watch_needed(void) {
  return atomic_load(&kept_waits) || atomic_load(&events) || !atomic_load(&has_waited);
}

static void *watch_until_told(void *unused) {
  bool left;
  do {
    uint64_t until = clock_now(CLOCK_REALTIME) + step_of(mode_now(), are_goals_held());
    struct timespec limit = {(time_t)(until / 1000000000ull), (long)(until % 1000000000ull)};
    sem_timedwait(&wake, &limit);
    pthread_mutex_lock(&mutex);
    atomic_store(&watched, false);
    left = !atomic_load(&ends);
    if (left) {
      give_out();
      count_partners(now());
      left = tell() || is_watch_needed();
    }
    pthread_mutex_unlock(&mutex);
  } while (left && !atomic_exchange(&watched, true));
  return unused;
}

/* See to it that what is kept here goes on when the mode lets it pass, and that partners are counted
 * where no thread waits: by a thread, which takes none of the process's signals. */
static void watch(void) {
  pthread_t thread;
  sigset_t all, before;
  sem_post(&wake);
  if (atomic_exchange(&watched, true)) return;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  if (pthread_create(&thread, NULL, watch_until_told, NULL))
    atomic_store(&watched, false);
  else
    pthread_detach(thread);
  pthread_sigmask(SIG_SETMASK, &before, NULL);
}

/* The middleware goes when the process ends, and the thread must not call it then. */
static void stop_watching(void) {
  struct timespec limit = {0, 0};
  clock_gettime(CLOCK_REALTIME, &limit);
  limit.tv_sec++;
  atomic_store(&ends, true);
  if (!pthread_mutex_timedlock(&mutex, &limit)) pthread_mutex_unlock(&mutex);
}

/* ---- Turns of executors, and partners ------------------------------------------------------ */

static __thread bool has_turns __attribute__((tls_model("initial-exec")));
static __thread void **waited_for __attribute__((tls_model("initial-exec")));

static void end_thread(void *slot) {
  end_taking();
  free(waited_for);
  atomic_store(&((struct layer_slot *)slot)->kind, LAYER_FREE);
}

/* A process that was forked has none of its parent's entities: they belong to threads that are
 * not there any more. Its files stay mapped, and are not touched. */
static void forget_in_child(void) {
  static const pthread_mutex_t fresh = PTHREAD_RECURSIVE_MUTEX_INITIALIZER_NP;
  memcpy(&mutex, &fresh, sizeof mutex);
  atomic_store(&file, NULL);
  memset(chains, 0, sizeof chains);
  gone = NULL;
  last_gone = &gone;
  gone_count = 0;
  kept = NULL;
  atomic_store(&kept_waits, 0);
  atomic_store(&events, NULL);
  atomic_store(&watched, false);
  atomic_store(&has_waited, false);
  sem_init(&wake, 0, 0);
  own_turns = NULL;
  has_turns = takes = false;
  begun = 0;
  pthread_setspecific(thread_ends, NULL);
}

/* This thread's slot as one that waits for work. */
static struct layer_slot *turns_of_thread(void) {
  if (has_turns || !atomic_load_explicit(&file, memory_order_acquire)) return own_turns;
  has_turns = true;
  atomic_store(&has_waited, true);
  pthread_mutex_lock(&mutex);
  own_turns = take_slot(LAYER_EXECUTOR, "");
  pthread_mutex_unlock(&mutex);
  if (own_turns) {
    own_turns->thread = (uint32_t)syscall(SYS_gettid);
    pthread_setspecific(thread_ends, own_turns);
  }
  return own_turns;
}

static void release(texts_t *texts) {
  for (size_t i = 0; texts->texts && i < texts->count; i++)
    texts->allocator.deallocate(texts->texts[i], texts->allocator.state);
  if (texts->texts) texts->allocator.deallocate(texts->texts, texts->allocator.state);
}

/* Note which nodes this process has discovered; mutex is held, so the node stays. */
static void look_around(struct layer_file *own, const void *node) {
  texts_t names = {0}, spaces = {0};
  if (CALL(rmw_get_node_names, RET_UNSUPPORTED, node, &names, &spaces) != RET_OK) return;
  uint32_t number = 0;
  size_t used = 0;
  atomic_store(&own->seen_count, 0);
  for (; number < names.count && number < spaces.count; number++) {
    const char *space = spaces.texts[number], *name = names.texts[number];
    size_t room = LAYER_SEEN - used;
    int length = snprintf(own->seen + used, room, "%s/%s", space && strcmp(space, "/") ? space : "",
                          name ? name : "");
    if (length < 0 || (size_t)length >= room) break;
    used += (size_t)length + 1;
  }
  atomic_store(&own->seen_count, number);
  release(&names);
  release(&spaces);
}

#ifndef LOOK_AROUND_NS /* tests have another one */
#define LOOK_AROUND_NS 3000000000ull
#endif

/* Count partners, by a thread that is about to wait: every second, and oftener in a process that
 * others wait for. A change means that nodes have come or gone: it looks for them this time and the
 * next, since the name of a node may come after its entities. */
static void count_partners(uint64_t at) {
  struct layer_file *own = atomic_load_explicit(&file, memory_order_acquire);
  if (!own) return;
  uint64_t looked = atomic_load_explicit(&own->looked, memory_order_relaxed);
  uint64_t every = mode_now() == LAYER_WORK ? 1000000000ull : 200000000ull;
  if (at - looked < every || !atomic_compare_exchange_strong(&own->looked, &looked, at)) return;
  compare_clocks();
  if (pthread_mutex_trylock(&mutex)) return;
  static int looks; /* that are due; mutex is held */
  if (looked / LOOK_AROUND_NS != at / LOOK_AROUND_NS && !looks) looks = 1;
  const void *node = NULL;
  EACH_PART(one) {
    const void *entity = one->address[ENTITY];
    if (one->kind == LAYER_NODE) node = entity;
    size_t number = 0;
    ret_t answer = RET_UNSUPPORTED;
    if (one->kind == LAYER_PUBLISHER)
      answer = CALL(rmw_publisher_count_matched_subscriptions, answer, entity, &number);
    else if (one->kind == LAYER_SUBSCRIPTION)
      answer = CALL(rmw_subscription_count_matched_publishers, answer, entity, &number);
    if (answer == RET_OK && one->slot && atomic_exchange(&one->slot->matched, number) != number)
      looks = 2;
  }
  if (looks && node) look_around(own, node), looks--;
  pthread_mutex_unlock(&mutex);
}

static uint64_t length_of(const duration_t *timeout) {
  if (!timeout || timeout->seconds > 1000000000ull) return UINT64_MAX;
  return timeout->seconds * 1000000000ull + timeout->nanoseconds;
}

EXPORT ret_t rmw_wait(entities_t *, entities_t *, entities_t *, entities_t *, entities_t *, void *,
                      const duration_t *);

/* The same of what a wait set has for an entity. */
static bool is_entity_held(const void *entity, uint32_t mode, bool goals) {
  const struct part *part = find_by(DATA, entity);
  return part && is_held(part, mode, goals);
}

/* Wait for what is not held, in short steps while the process does not work. As rmw_wait does it,
 * entries that are not ready become NULL. `room` has place for all entries. */
static ret_t wait_in_steps(__typeof__(&rmw_wait) real, entities_t *const all[5], void *set,
                           const duration_t *timeout, void **room) {
  uint64_t begun = now(), most = length_of(timeout);
  for (;;) {
    uint32_t mode = mode_now();
    bool goals = are_goals_held();
    uint64_t spent = now() - begun, left = spent < most ? most - spent : 0;
    if (left > step_of(mode, goals)) left = step_of(mode, goals);
    duration_t limit = {left / 1000000000ull, left % 1000000000ull};
    entities_t some[5];
    void **next = room;
    for (int i = 0; i < 5; i++) {
      some[i] = (entities_t){0, next};
      for (size_t j = 0; all[i] && j < all[i]->count; j++) {
        void *entity = all[i]->entities[j];
        if (!is_entity_held(entity, mode, goals)) some[i].entities[some[i].count++] = entity;
      }
      next += some[i].count;
    }
    ret_t answer = real(all[0] ? &some[0] : NULL, all[1] ? &some[1] : NULL, all[2] ? &some[2] : NULL,
                        all[3] ? &some[3] : NULL, all[4] ? &some[4] : NULL, set, &limit);
    if (answer == RET_TIMEOUT && now() - begun < most) {
      count_partners(now());
      if (own_turns) /* it runs, although it has nothing to do */
        atomic_store_explicit(&own_turns->last, now(), memory_order_relaxed);
      continue;
    }
    for (int i = 0; i < 5; i++)
      for (size_t j = 0, at = 0; all[i] && j < all[i]->count; j++) {
        bool held = is_entity_held(all[i]->entities[j], mode, goals);
        all[i]->entities[j] = held ? NULL : some[i].entities[at++];
      }
    return answer;
  }
}

static ret_t wait_by_mode(__typeof__(&rmw_wait) real, entities_t *const all[5], void *set,
                          const duration_t *timeout) {
  static __thread size_t places __attribute__((tls_model("initial-exec")));
  size_t total = 0;
  if (mode_now() == LAYER_WORK && !are_goals_held() &&
      (length_of(timeout) <= IDLE_NS || !atomic_load_explicit(&file, memory_order_acquire)))
    return real(all[0], all[1], all[2], all[3], all[4], set, timeout);
  for (int i = 0; i < 5; i++) total += all[i] ? all[i]->count : 0;
  if (total > places) {
    free(waited_for);
    waited_for = malloc(total * sizeof *waited_for);
    places = waited_for ? total : 0;
  }
  if (total > places) return real(all[0], all[1], all[2], all[3], all[4], set, timeout);
  return wait_in_steps(real, all, set, timeout, waited_for);
}

EXPORT ret_t rmw_wait(entities_t *subscriptions, entities_t *conditions, entities_t *services,
                      entities_t *clients, entities_t *events, void *set,
                      const duration_t *timeout) {
  __typeof__(&rmw_wait) real = REAL(rmw_wait);
  if (!real) return RET_ERROR;
  entities_t *const all[5] = {subscriptions, conditions, services, clients, events};
  struct layer_slot *turns = turns_of_thread();
  end_taking();
  begun = 0;
  if (turns) {
    uint64_t at = now();
    count_partners(at);
    atomic_store_explicit(&turns->last, at, memory_order_relaxed);
    atomic_store_explicit(&turns->set, (uint64_t)(uintptr_t)set, memory_order_relaxed);
    atomic_store_explicit(&turns->waiting, LAYER_WAITING, memory_order_release);
  }
  ret_t answer = wait_by_mode(real, all, set, timeout);
  turns = own_turns; /* none in a process that was forked meanwhile */
  if (turns) {
    atomic_store_explicit(&turns->waiting, LAYER_BUSY, memory_order_relaxed);
    atomic_store_explicit(&turns->last, now(), memory_order_relaxed);
    add(&turns->count, 1);
  }
  return answer;
}

/* A timer's callback begins. It is a function of librcl, which all client libraries call for this:
 * the middleware does not know of timers. */
static void begin_timer(void) {
  uint32_t mode = mode_now();
  begun = mode == LAYER_WORK || mode == LAYER_FINISH ? now() : 0;
}

EXPORT ret_t rcl_timer_call(void *timer) {
  begin_timer();
  return CALL(rcl_timer_call, RET_ERROR, timer);
}

EXPORT ret_t rcl_timer_call_with_info(void *timer, void *info) {
  begin_timer();
  return CALL(rcl_timer_call_with_info, RET_ERROR, timer, info);
}
