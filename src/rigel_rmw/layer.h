/* What the layer keeps in mapped files; rigel_inpod/rmw_notes.py is the twin of this file.
 *
 * A container has a directory (RIGEL_RMW) with the file `control`, which says to all of its
 * processes what they may do, and one file for each process, which only that process writes.
 *
 * All times are nanoseconds of CLOCK_MONOTONIC, which all containers of a machine share. An age is
 * the time between a message's source timestamp and its taking, by the clocks of both machines.
 */
#ifndef RIGEL_LAYER_H
#define RIGEL_LAYER_H

#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

#define LAYER_VERSION 6
#define LAYER_NAME 256
#define LAYER_TYPE 128
#define LAYER_END 64 /* the signal that ends process 1 of a container (stop.sh) */

enum layer_kind {
  LAYER_FREE = 0,
  LAYER_NODE,
  LAYER_PUBLISHER,
  LAYER_SUBSCRIPTION,
  LAYER_SERVICE,
  LAYER_CLIENT,
  LAYER_EXECUTOR, /* a thread that waits for work */
};

/* What the processes of a container may do. */
enum layer_mode {
  LAYER_WORK = 0,
  LAYER_WAIT,   /* they run, and publish and handle nothing, except what builds up their state */
  LAYER_HOLD,   /* what arrives stays in the middleware's queues */
  LAYER_FINISH, /* they take nothing more, and finish what they have taken */
  LAYER_STOP,   /* they publish nothing, either; responses to what they have taken still pass */
};

/* ---- The file `control` --------------------------------------------------------------------- */

/* What the process before this one has taken of one publisher or client: the newest number.
 * `tag` is mix(the key of the subscription or service, the writer). A goal of an action that is
 * the other one's has mix(LAYER_GOALS, its UUID), and any number. The list is a hash table with
 * linear probing from `tag % LAYER_DROPS`; tag 0 is a free place. */
#define LAYER_DROPS 4096
#define LAYER_GOALS 0x676f616c73ull
struct layer_drop {
  uint64_t tag;
  uint64_t number;
};

/* A process: how the identifiers of its entities begin (on zenoh, of a client). `friends` are
 * those of the container, which they note themselves; `others` those of the workload's other pods,
 * which the keeper writes. What such a process requests is for its own pod: a lifecycle manager's
 * for its own nodes. The other pods drop it once they have a friend among their others, which the
 * keeper notes as `known`. */
#define LAYER_FRIENDS 256
struct layer_friend {
  _Atomic uint32_t pid;
  _Atomic uint32_t known;
  uint8_t prefix[12];
};

struct layer_control {
  char magic[8]; /* "rigelctl" */
  uint32_t version;
  _Atomic uint32_t mode;
  _Atomic uint32_t hold_goals; /* whether requests for new goals stay in the queue */
  _Atomic uint32_t drop_count; /* 0 while `drop` is being written */
  struct layer_drop drop[LAYER_DROPS];
  struct layer_friend friends[LAYER_FRIENDS];
  struct layer_friend others[LAYER_FRIENDS];
};

/* ---- The file of a process ------------------------------------------------------------------ */

/* The newest number that one publisher or client has sent to one subscription or service: the
 * publication's sequence number, its source timestamp where the middleware does not count, or the
 * request's sequence number. */
#define LAYER_WRITERS 1024
struct layer_writer {
  _Atomic uint64_t tag; /* mix(key, what the middleware calls it here); 0: a free place */
  uint64_t key;
  _Atomic uint64_t writer[2]; /* what it is called in every process, 16 bytes */
  _Atomic uint64_t taken;   /* of what the node was given */
  _Atomic uint64_t dropped; /* of what the mode did not let pass */
  _Atomic uint64_t last;    /* a time; the place of the longest silent one is used again */
};

/* A goal that this process was asked for. */
enum layer_goal_state { LAYER_NO_GOAL = 0, LAYER_CLAIMED, LAYER_ASKED, LAYER_OPEN, LAYER_ENDED };
#define LAYER_GOAL_COUNT 256
struct layer_goal {
  _Atomic uint32_t state;
  uint32_t service; /* the slot of the service that took the request */
  uint8_t uuid[16];
  uint8_t client[16]; /* who asked, and */
  int64_t number;     /* the request's sequence number */
};

/* The longest gap is kept for each of the last windows of ten seconds. */
#define LAYER_WINDOWS 7
#define LAYER_WINDOW_NS 10000000000ull
struct layer_gap {
  _Atomic uint64_t window; /* its number since the machine started */
  _Atomic uint64_t longest;
};

/* An executor that is called when something arrives does not say whether it waits. */
enum layer_waiting { LAYER_BUSY = 0, LAYER_WAITING, LAYER_UNKNOWN };

#define LAYER_SLOTS 2048
#define LAYER_BLOCK 32 /* slots that get memory together */
struct layer_slot {
  _Atomic uint32_t kind;
  uint32_t node;    /* the slot of its node */
  uint32_t thread;  /* of an executor: the kernel's thread id */
  uint32_t free_;
  uint64_t key;     /* names it in every process of the workload: hash of kind, node, name, which */
  _Atomic uint64_t created;
  _Atomic uint64_t count;   /* messages, requests or turns */
  _Atomic uint64_t answers; /* of services and clients: responses; of transition events: the state */
  _Atomic uint64_t bytes;   /* of serialized messages; of others the size is not known */
  _Atomic uint64_t last;    /* the time of the last one; of an executor: of the last change */
  _Atomic uint64_t waiting; /* of an executor: whether it waits for work (enum layer_waiting) */
  _Atomic uint64_t set;     /* of an executor: what it waits with; threads may share it */
  _Atomic uint64_t matched; /* partners */
  _Atomic uint64_t age;     /* of the last message that was taken; of an executor: the time of that */
  _Atomic uint64_t refused; /* calls that the middleware answered with an error */
  _Atomic uint64_t dropped; /* messages and requests that the mode did not let pass */
  struct layer_gap gaps[LAYER_WINDOWS];
  char name[LAYER_NAME];
  char type[LAYER_TYPE]; /* std_msgs/msg/String; "" if the middleware hides it */
};

#define LAYER_SEEN 65536
struct layer_file {
  char magic[8]; /* "rigelrmw" */
  uint32_t version;
  uint32_t pid;
  uint64_t birth; /* when the process started, and where its stack starts, as /proc/PID/stat has */
  uint64_t stack; /* it: they tell it from a later process, and from a later program, of its PID */
  _Atomic uint64_t looked; /* when partners were counted last */
  _Atomic uint32_t used;   /* slots that were in use at some time */
  _Atomic uint32_t full;   /* entities for which no slot was left */
  _Atomic uint32_t ended;  /* the process has ended by itself */
  _Atomic uint32_t taking; /* threads that are taking something */
  uint32_t helper;         /* whether it is a program of ours beside the node */
  _Atomic uint32_t goals;  /* goals that were asked for */
  _Atomic uint32_t seen_count; /* 0 while `seen` is being written */
  uint32_t free_;
  char middleware[64];
  char seen[LAYER_SEEN]; /* nodes that the process has discovered, its own among them: names that end with 0 */
  struct layer_writer writers[LAYER_WRITERS];
  struct layer_goal goal[LAYER_GOAL_COUNT];
  struct layer_slot slot[LAYER_SLOTS];
};

/* Bring two things that name something into one number, never 0. */
static inline uint64_t layer_mix(uint64_t key, uint64_t first, uint64_t second) {
  uint64_t sum = (key ^ first) * 0x9E3779B97F4A7C15ull;
  sum = ((sum ^ sum >> 32) ^ second) * 0xC2B2AE3D27D4EB4Full;
  return (sum ^ sum >> 29) | 1;
}

#endif
